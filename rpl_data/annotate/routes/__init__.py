"""Routes of the annotation server, one module per subject; the work is done in the modules above."""
