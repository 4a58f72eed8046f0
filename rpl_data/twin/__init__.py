"""The twin: RGB-D recordings rendered from made-up scenes, with exact ground truth.

A twin has objects on a table, a hand-held camera path, a renderer, a model of the sensor's errors, and a
simulated annotator who clicks.
"""

from rpl_data.twin.spec import TwinSpec
from rpl_data.twin.write import write_twin

__all__ = ["TwinSpec", "write_twin"]
