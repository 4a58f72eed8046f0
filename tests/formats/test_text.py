"""Texts as table programs and other tools write them: marks, separators, lost rows, more columns."""

from __future__ import annotations

import codecs
from pathlib import Path

import numpy as np
import pytest
from recordings import poses

from rpl_data.files import read_text
from rpl_data.formats.recordings.camera_file import read_camera
from rpl_data.formats.recordings.pose_lines import read_pose_rows, write_pose_lines
from rpl_data.types import DataError


@pytest.mark.parametrize(
    ("mark", "encoding"),
    [
        (b"", "utf-8"),
        (codecs.BOM_UTF8, "utf-8"),
        (codecs.BOM_UTF16_LE, "utf-16-le"),
        (codecs.BOM_UTF16_BE, "utf-16-be"),
    ],
)
def test_a_text_is_read_by_its_mark(tmp_path: Path, mark: bytes, encoding: str) -> None:
    (tmp_path / "a.txt").write_bytes(mark + "Grüße 1.5\r\n2\r\n".encode(encoding))
    assert read_text(tmp_path / "a.txt") == "Grüße 1.5\n2\n"


def test_text_that_is_not_what_it_should_be_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a.txt").write_bytes("Grüße".encode("latin-1"))
    with pytest.raises(DataError, match=r"cannot read .*a.txt"):
        read_text(tmp_path / "a.txt")


@pytest.fixture
def path(tmp_path: Path) -> Path:
    write_pose_lines(tmp_path / "camera.poses", [0.0, 0.1, 0.2, 0.3], poses(4))
    return tmp_path / "camera.poses"


def test_semicolons_with_decimal_commas_are_read_right(path: Path) -> None:
    path.write_text(path.read_text().replace(" ", "; ").replace(".", ","))
    rows = read_pose_rows(path)
    np.testing.assert_allclose(rows.times, [0.0, 0.1, 0.2, 0.3])
    np.testing.assert_allclose(rows.poses, poses(4), atol=1e-8)


@pytest.mark.parametrize(("old", "new"), [(".", ","), (" ", ",")])
def test_commas_alone_are_refused(path: Path, old: str, new: str) -> None:
    path.write_text(path.read_text().replace(old, new))
    with pytest.raises(DataError, match=r"camera.poses line 1: "):
        read_pose_rows(path)


def test_what_only_python_takes_for_a_number_is_refused(path: Path) -> None:
    """A slip of the finger would move a camera by hundreds of pixels, or a pose by metres, in silence."""
    whole = path.read_text()
    path.write_text(whole.replace("0.100000 ", "0_1.100000 "))
    with pytest.raises(DataError, match=r"camera.poses line 2: '0_1.100000' is no number"):
        read_pose_rows(path)
    for text in ("600 600 3_07.5 240", "600 600 307.5 240\ndistortion 0_1 0 0 0"):
        path.write_text(text)
        with pytest.raises(DataError, match="_"):
            read_camera(path)


LOST = (
    "nan nan nan nan nan nan nan",
    "-inf 0 0 0 0 0 1",
    "0 0 0 0 0 0 0",
    "-nan(ind) 0 0 0 0 0 1",
    "0 -1.#IND 0 0 0 0 1",
)


@pytest.mark.parametrize("lost", LOST)
def test_rows_of_a_lost_tracker_are_left_out_and_counted(path: Path, lost: str) -> None:
    path.write_text(path.read_text() + f"0.4 {lost}\n")
    rows = read_pose_rows(path)
    np.testing.assert_allclose(rows.times, [0.0, 0.1, 0.2, 0.3])
    assert rows.lost == ("1 line of camera.poses left out: not finite, or a quaternion of zeros",)


def test_rtab_maps_ninth_column_is_read_and_no_other(path: Path) -> None:
    lines = path.read_text().splitlines()
    path.write_text("#timestamp x y z qx qy qz qw id\n" + "".join(f"{line} 7\n" for line in lines))
    np.testing.assert_allclose(read_pose_rows(path).poses, poses(4), atol=1e-8)
    for more in ("0.25", "7 8", "x"):
        path.write_text("".join(f"{line} {more}\n" for line in lines))
        with pytest.raises(DataError, match=r"line 1: expected 't tx ty tz qx qy qz qw'"):
            read_pose_rows(path)


def test_a_ninth_column_that_was_cut_off_takes_its_line_with_it(path: Path) -> None:
    lines = [f"{line} 1{n}" for n, line in enumerate(path.read_text().splitlines())]
    path.write_text("\n".join(lines)[:-3])
    assert len(read_pose_rows(path).times) == 3


@pytest.mark.parametrize(
    "text",
    [
        "525 526 319.5 239.5\n",
        "# K\n525 0 319.5\n0 526 239.5\n0 0 1\n",
        "5.25e+02 0 3.195e+02 0 5.26e+02 2.395e+02 0 0 1\n",
        "525 0 319.5 0\n0 526 239.5 0\n0 0 1 0\n0 0 0 1\n",
        "525;526;319,5;239,5\n",
    ],
)
def test_a_camera_is_four_numbers_or_the_matrix(tmp_path: Path, text: str) -> None:
    (tmp_path / "camera.txt").write_text(text + "metres_per_unit 0.0002\n")
    found = read_camera(tmp_path / "camera.txt")
    assert (found.camera, found.metres_per_unit) == ((525.0, 526.0, 319.5, 239.5), 0.0002)


@pytest.mark.parametrize(
    "text",
    [
        "525 0 319.5\n0 526 239.5\n0 1 0\n",
        "525 319.5 0\n0 526 239.5\n0 0 1\n",
        "525 526 319.5 239.5 640\n",
    ],
)
def test_a_matrix_that_is_no_camera_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "camera.txt").write_text(text)
    with pytest.raises(DataError, match=r"camera.txt: expected one line: fx fy cx cy"):
        read_camera(tmp_path / "camera.txt")
