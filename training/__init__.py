"""Programs run from a checkout: training, evaluation, and the paper's experiments (`training.reproduce`)."""
