"""What `training.gpu_check` measures: speeds of training steps, and short trainings on an export."""
