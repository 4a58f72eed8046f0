"""The workspace: the files that the stages write and read, and how each record is stored in them."""
