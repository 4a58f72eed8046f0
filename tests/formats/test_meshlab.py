"""MeshLab's picked points."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from rpl_data.formats.models.meshlab import read_picked_points, write_picked_points
from rpl_data.types import DataError

NAN = [np.nan] * 3


def test_what_is_written_is_read(tmp_path: Path) -> None:
    points = np.array([[0.1, -2e-05, 0.3], NAN, [-1.0, 0.0, 2.5e-17]])
    write_picked_points(tmp_path / "a.pp", ["spout & lid", 'the "handle"', "foot"], points, mesh_file="a.ply")
    read = read_picked_points(tmp_path / "a.pp")
    assert read.names == ("spout & lid", 'the "handle"', "foot")
    np.testing.assert_array_equal(read.points_mesh, points)
    assert '<DataFileName name="a.ply"/>' in (tmp_path / "a.pp").read_text()


def test_as_meshlab_writes_it(tmp_path: Path) -> None:
    """Both orders of attributes seen, a header of other length, numbers out of order, a point not picked."""
    (tmp_path / "a.pp").write_text(
        "<!DOCTYPE PickedPoints>\n<PickedPoints>\n <DocumentData>\n  <DateTime date='2020-1-1'/>\n"
        '  <DataFileName name="can.ply"/>\n  <templateName name="new"/>\n </DocumentData>\n'
        ' <point y="2e-05" z="-3" active="1" name="3" x="1"/>\n'
        ' <point x="4" y="5" z="6" active="1" name="0"/>\n'
        ' <point x="0" y="0" z="0" active="0" name="1"/>\n</PickedPoints>\n'
    )
    read = read_picked_points(tmp_path / "a.pp", metres_per_unit=0.001)
    assert read.names == ("0", "1", "2", "3")
    np.testing.assert_allclose(read.points_mesh, [[0.004, 0.005, 0.006], NAN, NAN, [0.001, 2e-08, -0.003]])


def pp(*attributes: str) -> str:
    return "<PickedPoints>" + "".join(f"<point {each}/>" for each in attributes) + "</PickedPoints>"


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("x", "is not a PickedPoints file"),
        ("<a/>", "holds <a>; expected <PickedPoints>"),
        (pp(), "has no point"),
        (pp('x="1" y="2" name="0"'), "point '0' needs numbers x, y and z"),
        (pp('x="1" y="2" z="0,3" name="0"'), "needs numbers x, y and z"),
        (pp('x="1" y="2" z="inf" name="0"'), "is not finite"),
        (pp('x="1" y="2" z="3"'), "point 0 has no name of its own"),
        (pp('x="1" y="2" z="3" name="a"', 'x="4" y="5" z="6" name="a"'), "point 1 has no name of its own"),
        (pp('x="1" y="2" z="3" name="1"', 'x="4" y="5" z="6" name="01"'), "numbers of the points are 1, 01"),
    ],
)
def test_bad_files_are_refused(tmp_path: Path, content: str, message: str) -> None:
    (tmp_path / "a.pp").write_text(content)
    with pytest.raises(DataError, match=message):
        read_picked_points(tmp_path / "a.pp")


def test_no_point_is_made_up_in_front_of_the_first(tmp_path: Path) -> None:
    (tmp_path / "a.pp").write_text(pp('x="1" y="0" z="0" name="3"', 'x="2" y="0" z="0" name="1"'))
    read = read_picked_points(tmp_path / "a.pp")
    assert read.names == ("1", "2", "3")
    np.testing.assert_array_equal(read.points_mesh[:, 0], [2, np.nan, 1])
