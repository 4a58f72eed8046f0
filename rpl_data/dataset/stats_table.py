"""The counts of a dataset as a table for the terminal."""

from __future__ import annotations

from rpl_data.json_arrays import Json
from rpl_data.wording import counted


def stats_table(found: Json) -> list[str]:
    """Lines of text that say what `stats.dataset_stats` found."""
    lines = [
        f"{name}: {counted(count, 'image')}, {counted(found['annotations'].get(name, 0), 'instance')}"
        + (f", {found['ignored'][name]} to be ignored" if found["ignored"].get(name) else "")
        for name, count in found["images"].items()
    ]
    lines += ["", f"{'object':20s} instances  scenes  visible p10/median  quality p10/median  distance (m)  "]
    lines[-1] += "keypoints seen  views within 15 deg  widest gap"
    lines += [_object(name, item) for name, item in found["objects"].items()]
    lines += ["", f"{'scene':20s} images  split        instances"]
    for name, scene in found["scenes"].items():
        objects = ", ".join(f"{item} {count}" for item, count in sorted(scene["instances"].items()))
        lines.append(f"{name:20s} {scene['images']:6d}  {'+'.join(scene['split']):11s}  {objects}")
    lines += ["", found["content_hash"] + _agreement(found["as_recorded"])]
    return lines


def _object(name: str, item: Json) -> str:
    if not item["instances"]:
        return f"{name:20s} {0:9d}"
    visible, quality, away, views = (item[key] for key in ("visible", "quality", "distance_m", "views"))
    return (
        f"{name:20s} {item['instances']:9d}  {item['scenes']:6d}  "
        f"{visible['p10']:11.2f} / {visible['median']:.2f}"
        f"  {quality['p10']:11.2f} / {quality['median']:.2f}  {away['least']:.2f} to {away['most']:.2f}  "
        f"{item['keypoints']['seen']:14.0%}  {views['covered']:19.0%}  {views['widest_gap_deg']:6.0f} deg"
    )


def _agreement(as_recorded: bool | None) -> str:
    """What the version file says of the content."""
    said = {
        None: "",
        True: ", as dataset.json has it",
        False: ", which dataset.json does not: it was changed",
    }
    return said[as_recorded]
