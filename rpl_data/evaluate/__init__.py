"""Labels and models compared with the truth, where it is known (paper IV-A)."""
