"""The numerical machinery of the sparse solve: starts, Eq. 2 on points, and rays with depths.

Shapes and names everywhere: S scenes, K keypoints, ``scene_from_model`` a stack (S, 4, 4) and
``points_model`` (K, 3), where ``model`` is whatever frame the unknowns are in at the time.
"""
