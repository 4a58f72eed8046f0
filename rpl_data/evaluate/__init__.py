"""Compare labels and models with the ground truth, where it is known (paper, section IV-A)."""
