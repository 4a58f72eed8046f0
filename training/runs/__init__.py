"""What every training run shares: trainer, options and the program around it."""
