"""MATLAB files: what SciPy writes is read as SciPy reads it, and what is damaged is refused."""

from __future__ import annotations

import random
from pathlib import Path

import numpy as np
import pytest
from scipy.io import loadmat, savemat

from rpl_data.formats.containers.mat import read_mat
from rpl_data.types import DataError

ARRAYS = {
    "poses": np.arange(24.0).reshape(3, 4, 2), "cls_indexes": np.array([[1], [2]], np.uint8),
    "factor_depth": np.array([[10000]], np.uint16), "k": np.eye(3, dtype=np.float32),
    "text": np.array(["abc"]), "complex": np.array([1 + 2j]), "cell": np.array([1, "a"], dtype=object),
}  # fmt: skip
WANTED = ("poses", "cls_indexes", "factor_depth", "k", "text", "complex", "cell", "missing")


@pytest.mark.parametrize("packed", [True, False])
def test_numbers_are_read_as_scipy_reads_them(tmp_path: Path, packed: bool) -> None:
    savemat(tmp_path / "a.mat", ARRAYS, do_compression=packed)
    found, judge = read_mat(tmp_path / "a.mat", WANTED), loadmat(tmp_path / "a.mat")
    assert found.keys() == {"poses", "cls_indexes", "factor_depth", "k"}
    for name, array in found.items():
        np.testing.assert_array_equal(array, judge[name])
    assert read_mat(tmp_path / "a.mat", ["k"]).keys() == {"k"}


@pytest.mark.parametrize("packed", [True, False])
def test_no_damage_ends_in_anything_but_an_answer(tmp_path: Path, packed: bool) -> None:
    savemat(tmp_path / "a.mat", ARRAYS, do_compression=packed)
    good, chance, refused = (tmp_path / "a.mat").read_bytes(), random.Random(3), 0
    for _ in range(400):
        content = bytearray(good)
        for _ in range(chance.choice([1, 4])):
            content[chance.randrange(124, len(content))] = chance.randrange(256)
        (tmp_path / "b.mat").write_bytes(
            content[: chance.randrange(len(content)) if chance.random() < 0.2 else None]
        )
        try:
            read_mat(tmp_path / "b.mat", WANTED)
        except DataError as error:
            assert "b.mat" in str(error) and "copy it again" in str(error)
            refused += 1
    assert refused > 50


def test_an_array_that_would_unpack_to_gigabytes_is_refused(tmp_path: Path) -> None:
    savemat(tmp_path / "a.mat", {"k": np.zeros((6000, 6000))}, do_compression=True)
    assert (tmp_path / "a.mat").stat().st_size < 1_000_000
    with pytest.raises(DataError, match="an array is larger than 256 MB"):
        read_mat(tmp_path / "a.mat", ["k"])
