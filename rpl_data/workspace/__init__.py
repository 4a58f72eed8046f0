"""Our files on disk: what a workspace holds, and the records that stages hand one another."""
