"""Recipe -> workspace: which steps there are, which of them still hold, and running the others."""
