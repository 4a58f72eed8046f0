"""Programs: `rpl train`, `rpl evaluate`, `rpl predict`, and the paper's experiments, `rpl reproduce`.

`python -m training.train_keypoints` and the like run them from a checkout. Where `rpl-data` is installed they
are `rpl_data.training`, so its modules import one another relatively.
"""
