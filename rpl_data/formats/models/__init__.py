"""Models of objects that other tools write: keypoints, picked points, surfels.

`sparse_model` and `meshlab` serve the annotation page and the report; `meta_data` (RapidPoseLabels'
`saved_meta_data.npz`) and `surfels` (ElasticFusion's surfaces) are readers for your own scripts.
"""
