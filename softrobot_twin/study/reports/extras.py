"""Libraries that only pictures need, asked for by name when one is wanted."""

from __future__ import annotations

from types import ModuleType

from softrobot_twin.errors import SoftRobotTwinError


class MissingExtraError(SoftRobotTwinError):
    """A picture was asked for and the library that draws it is not installed.

    Attributes:
        library: Name of the library.
    """

    def __init__(self, library: str):
        self.library = library
        super().__init__(f"{library} is not installed; pictures need it: "
                         f"pip install {library}")


def load_pyplot() -> ModuleType:
    """matplotlib's pyplot, drawing to files and never to a window.

    Raises:
        MissingExtraError: matplotlib is not installed.
    """
    try:
        import matplotlib
    except ImportError as error:
        raise MissingExtraError("matplotlib") from error
    matplotlib.use("Agg")
    from matplotlib import pyplot
    return pyplot
