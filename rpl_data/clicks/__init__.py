"""What a person marks: the log of clicks, their depth, rigid bodies and grasps; for page and solver."""
