"""How far camera poses drift, as the depth of a recording tells."""
