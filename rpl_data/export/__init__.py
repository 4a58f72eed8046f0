"""Labels of a workspace -> folders that trainers read.

`coco` is made of the labels and holds everything; the other dialects are made of it, with the same split.
"""

from rpl_data.export.bop import export_bop
from rpl_data.export.coco import ExportScene, ExportSummary, export_coco
from rpl_data.export.okt import export_okt
from rpl_data.export.yolo import export_yolo

__all__ = ["ExportScene", "ExportSummary", "export_bop", "export_coco", "export_okt", "export_yolo"]
