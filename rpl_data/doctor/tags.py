"""Find images that ask their viewers to turn them."""

from __future__ import annotations

from collections import Counter

from rpl_data.doctor.findings import Finding
from rpl_data.orientation import AS_STORED, orientation_of
from rpl_data.types import Scene, spread_evenly
from rpl_data.wording import counted


def orientation_tags(scene: Scene, *, most: int = 300) -> list[Finding]:
    """Return a finding when colour images carry a tag to turn them; `most` of them are looked at, evenly."""
    chosen = spread_evenly(scene.frames, most)
    tags = Counter(orientation_of(frame.color) for frame in chosen)
    asking = {tag: count for tag, count in sorted(tags.items()) if tag != AS_STORED}
    if not asking:
        return []
    listed = ", ".join(f"{tag} in {count}" for tag, count in asking.items())
    mixed = "; the tags differ: the camera was turned while it recorded" if len(tags) > 1 else ""
    what = (
        f"{sum(asking.values())} of {counted(len(chosen), 'colour image')} examined ask viewers to turn them "
        f"(EXIF orientation {listed}), which depth images cannot{mixed}"
    )
    todo = (
        "nothing here: pixels are read as they are stored and exported without the tag. Other programs may "
        "turn them; intrinsics and clicks must be those of the stored image"
    )
    return [Finding("orientation", what, 1.0, todo)]
