"""Write the labels of a workspace to folders that trainers read.

`coco` is made from the labels and holds everything; the other dialects are made from it, with the same split.
"""

from rpl_data.export.assets import export_assets
from rpl_data.export.bop import export_bop
from rpl_data.export.bop_onboarding import export_bop_onboarding
from rpl_data.export.bundlesdf import export_bundlesdf
from rpl_data.export.coco import ExportScene, ExportSummary, export_coco
from rpl_data.export.coco_per_object import export_coco_per_object
from rpl_data.export.foundationpose import export_foundationpose
from rpl_data.export.huggingface import export_huggingface
from rpl_data.export.linemod import export_linemod
from rpl_data.export.nerfstudio import export_nerfstudio
from rpl_data.export.okt import export_okt
from rpl_data.export.webdataset import export_webdataset
from rpl_data.export.ycb_video import export_ycb_video
from rpl_data.export.yolo import export_yolo

__all__ = [
    "ExportScene",
    "ExportSummary",
    "export_assets",
    "export_bop",
    "export_bop_onboarding",
    "export_bundlesdf",
    "export_coco",
    "export_coco_per_object",
    "export_foundationpose",
    "export_huggingface",
    "export_linemod",
    "export_nerfstudio",
    "export_okt",
    "export_webdataset",
    "export_ycb_video",
    "export_yolo",
]
