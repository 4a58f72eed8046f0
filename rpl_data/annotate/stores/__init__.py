"""What the annotation server keeps in memory: scenes, pictures and masks."""
