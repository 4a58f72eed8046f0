"""The contact sheet of the augmentations."""

import cv2
import pytest
from labelled_scenes import exported

from rpl_data.torch import Augmentation
from rpl_data.types import DataError
from training.show_batch import GAP_PX, HEADING_PX, show_batch


def test_a_row_per_augmentation(tmp_path, capsys):
    coco = exported(tmp_path / "export")
    wish = Augmentation(gain=0.0, offset=0.0, scale=0.0, shift=0.0, rotation_deg=180.0, background=1.0)
    path = show_batch(
        coco, "box", out=tmp_path / "sheets" / "batch.png", augment=wish, columns=3, input_px=64
    )
    assert capsys.readouterr().out.strip() == str(path)
    sheet, row = cv2.imread(str(path)), HEADING_PX + 64 + GAP_PX
    assert sheet.shape == (4 * row, 3 * (64 + GAP_PX), 3)  # as labelled, turned, before a background, both
    strips = [sheet[n * row : (n + 1) * row] for n in range(4)]
    assert all((a != b).any() for a, b in zip(strips, strips[1:], strict=False))


def test_a_picture_that_cannot_be_written_is_said(tmp_path):
    coco = exported(tmp_path / "export", frames=2)
    with pytest.raises(DataError, match="the picture is a PNG"):
        show_batch(coco, "box", out=tmp_path / "batch")
    (tmp_path / "taken.png").mkdir()
    with pytest.raises(DataError, match="cannot write"):
        show_batch(coco, "box", out=tmp_path / "taken.png", columns=1, input_px=64)
