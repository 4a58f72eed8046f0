"""What a file of clicks changes is counted click by click, and the events do just that."""

from rpl_data.clicks.incoming import incoming
from rpl_data.clicks.log import Annotation, click_event, keypoints_event, replay
from rpl_data.types import Click

OLD = [Click("it", k, "00", 3, 10.0 * k, 5.0) for k in range(3)]
ADDED, MOVED, SAME = Click("it", 0, "01", 1, 1.0, 1.0), Click("it", 0, "00", 3, 7.0, 5.0), OLD[1]
START = [keypoints_event("abc"), *map(click_event, OLD)]


def after(replaces: bool) -> tuple[str, set[Click]]:
    found = incoming(replay("it", START), "abc", [ADDED, MOVED, SAME], replaces=replaces)
    return str(found), set(replay("it", [*START, *found.events]).clicks)


def test_adding_keeps_what_the_file_does_not_name() -> None:
    said, clicks = after(replaces=False)
    assert said == "1 click added, 1 moved; 2 stay as before"
    assert clicks == {ADDED, MOVED, SAME, OLD[2]}


def test_replacing_removes_it() -> None:
    said, clicks = after(replaces=True)
    assert said == "1 click added, 1 moved, 1 removed; 1 stays as before"
    assert clicks == {ADDED, MOVED, SAME}


def test_a_new_list_of_keypoints_is_no_click() -> None:
    annotation = Annotation("it", tuple("abc"), tuple(OLD))
    found = incoming(annotation, "abcd", OLD, replaces=True)
    assert len(found.events) == 1 and (found.changed, str(found)) == (0, "no click changed; all 3 were there")
