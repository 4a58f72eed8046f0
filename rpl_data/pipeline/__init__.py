"""Every stage with its files: what it reads from a workspace and writes back to it."""
