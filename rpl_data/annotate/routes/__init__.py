"""The routes of the annotation server, one module per subject. What they do is in the modules above."""
