"""Labelled 6-DoF pose, keypoint and mask datasets from RGB-D videos and a few clicks.

The front door; everything else may move between releases::

    import rpl_data

    workspace = rpl_data.build("my.yaml", workspace="my-workspace")   # the whole pipeline, in one call
    workspace = rpl_data.Workspace("my-workspace")                    # or look into what is there
    workspace.label_arrays("cube").camera_from_object                 # (n, 4, 4), metres

`build`: recipe -> workspace. `Workspace`: scenes, labels, models and pictures of a workspace. `load_recipe`:
a YAML file as a `Recipe`. `open_recordings`: recordings of any format. `DataError`: what the user can mend.
The PyTorch Datasets are in `rpl_data.torch`.

Names are loaded when first used, so that importing this package takes no time.
"""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rpl_data.pipeline.front_door import build as build
    from rpl_data.pipeline.recipe_file import load_recipe as load_recipe
    from rpl_data.recordings.open import open_recordings as open_recordings
    from rpl_data.types import DataError as DataError
    from rpl_data.workspace.workspace import Workspace as Workspace

    __version__: str

__all__ = ["DataError", "Workspace", "__version__", "build", "load_recipe", "open_recordings"]

_MODULE_OF = {
    "build": "rpl_data.pipeline.front_door",
    "load_recipe": "rpl_data.pipeline.recipe_file",
    "open_recordings": "rpl_data.recordings.open",
    "DataError": "rpl_data.types",
    "Workspace": "rpl_data.workspace.workspace",
}


def __getattr__(name: str) -> Any:
    """Load a name of the front door when it is first used (PEP 562)."""
    if name == "__version__":
        from rpl_data.version import installed_version

        return installed_version()
    if name not in _MODULE_OF:
        raise AttributeError(f"module 'rpl_data' has no attribute {name!r}; it has {', '.join(__all__)}")
    from importlib import import_module

    value = globals()[name] = getattr(import_module(_MODULE_OF[name]), name)
    return value


def __dir__() -> list[str]:
    """What there is to complete."""
    return list(__all__)
