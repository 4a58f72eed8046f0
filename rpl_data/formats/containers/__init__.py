"""Files that hold a whole recording: their bytes, not yet scenes."""
