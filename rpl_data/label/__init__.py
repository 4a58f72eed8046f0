"""Labels of every frame, made from poses and dense models (paper III-E)."""
