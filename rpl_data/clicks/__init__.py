"""What a person marks: the log of clicks, their positions in depth, rigid bodies and grasps. Shared by page and solver."""
