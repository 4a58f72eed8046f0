"""Camera tracking, correction of given poses, and fusion of depth to a surface (paper III-A)."""
