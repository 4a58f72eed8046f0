"""What the page is told of each scene."""

import numpy as np

from rpl_data.annotate.live import Live
from rpl_data.annotate.log import Revision
from rpl_data.annotate.payload import result_payload
from rpl_data.annotate.session import Result
from rpl_data.clicks.log import Annotation
from rpl_data.types import Click, KeypointModel, Solution, Statement


def test_a_scene_that_its_clicks_place_badly_is_not_called_good():
    scenes = ("00", "01")
    clicks = tuple(Click("it", k, scene, 3, 10.0 * k, 5.0) for scene in scenes for k in range(3))
    weak = Statement("weak scene", clicks[3:], "scene 01: its clicks fit almost as well 80 mm away")
    solution = Solution(
        KeypointModel("it", tuple("abc"), np.eye(3)),
        np.tile(1e-6 * np.eye(3), (3, 1, 1)),
        {scene: np.eye(4) for scene in scenes},
        statements=(weak,),
    )
    revision = Revision(1, Annotation("it", tuple("abc"), clicks=clicks), None, None)

    def states(off_px: float) -> dict[str, str]:
        result = Result(revision, Live(solution), (), expected_px={"01": off_px}, limits_px=(5.0, 15.0))
        return {name: scene["state"] for name, scene in result_payload(result, scenes)["scenes"].items()}

    assert states(1.0) == {"00": "tied", "01": "weak"}
    assert states(6.0)["01"] == "rough"
