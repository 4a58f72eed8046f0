"""A known object found in a scene without clicks: shape proposes, print and free space verify."""
