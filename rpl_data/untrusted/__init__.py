"""What comes from others, checked before it is believed: names, masks, PLY files, native readers."""
