"""Makes matplotlib figures with a common style, and writes and closes them."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from types import ModuleType
from typing import Any

from softrobot_twin.errors import SoftRobotTwinError
from softrobot_twin.harness.output_file import OutputError, output_file


class MissingExtraError(SoftRobotTwinError):
    """A library is needed that is not installed.

    Attributes:
        library: Name of the library.
    """

    def __init__(self, library: str, needed: str = "pictures need it"):
        self.library = library
        super().__init__(f"{library} is not installed; {needed}: pip install {library}")


def load_pyplot() -> ModuleType:
    """matplotlib's pyplot, drawing to files and never to a window, unless its user chose otherwise.

    Who has imported pyplot before, such as a notebook, keeps the backend and its own figures.

    Raises:
        MissingExtraError: matplotlib is not installed.
    """
    try:
        import matplotlib
    except ImportError as error:
        raise MissingExtraError("matplotlib") from error
    if "matplotlib.pyplot" not in sys.modules:
        matplotlib.use("Agg")
    from matplotlib import pyplot
    return pyplot


_STYLE = {"axes.spines.top": False, "axes.spines.right": False, "axes.grid": True,
          "grid.color": "#e6e6e6", "grid.linewidth": 0.8, "axes.axisbelow": True,
          "axes.edgecolor": "#888888", "axes.titlesize": 11, "axes.titlelocation": "left",
          "font.size": 9, "legend.frameon": False}


# Height below the axes that their numbers and label take, and the text of a legend [inch].
_BELOW, _CHARACTER, _LINE = 0.42, 0.072, 0.42


def legend_below(axes, width: float, **look) -> None:
    """Adds a legend below the axes, where it hides nothing, in as many columns as fit.

    Args:
        axes: Its axes; those of `figure_file` leave room for it.
        width: Width of the axes, about [inch].
        look: Further arguments of matplotlib's legend.
    """
    from matplotlib.transforms import ScaledTranslation
    handles, labels = axes.get_legend_handles_labels()
    longest = max(map(len, labels), default=0)
    columns = max(1, int(width / (_CHARACTER * longest + _LINE)))
    below = axes.transAxes + ScaledTranslation(0.0, -_BELOW, axes.figure.dpi_scale_trans)
    axes.legend(handles, labels, loc="upper left", bbox_to_anchor=(0.0, 0.0),
                bbox_transform=below, borderaxespad=0.0, ncols=min(columns, len(labels) or 1),
                fontsize=8, handlelength=1.4, columnspacing=1.2, **look)


def png_of(figure: Any, dpi: int) -> bytes:
    """A figure as PNG with a palette of colours, which makes it small.

    Args:
        figure: The figure.
        dpi: Pixels per inch.
    """
    from PIL import Image  # matplotlib writes its own pictures with it
    whole, small = BytesIO(), BytesIO()
    figure.savefig(whole, dpi=dpi, format="png")
    # No colour is far off, that of a small mark neither.
    few = Image.open(whole).convert("RGB").quantize(
        256, method=Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE)
    few.save(small, format="PNG", optimize=True, dpi=(dpi, dpi))
    return small.getvalue()


@contextmanager
def figure_file(path: Path, size: tuple[float, float], title: str, foot: str = "") -> Iterator:
    """An empty matplotlib figure to draw on; leaving the context writes it.

    Args:
        path: Picture to write; its suffix determines the format.
        size: Width and height [inch].
        title: Title at the top.
        foot: Small text at the bottom.

    Raises:
        MissingExtraError: matplotlib is not installed.
        OutputError: The picture cannot be written.
    """
    pyplot = load_pyplot()
    with pyplot.rc_context(_STYLE):
        figure = pyplot.figure(figsize=size, layout="constrained")
        try:
            yield figure
            figure.suptitle(title, fontsize=13, x=0.01, ha="left", weight="bold")
            if foot:
                figure.supxlabel(foot, fontsize=7, color="#777777", x=0.01, ha="left")
            write_figure(figure, path, 130)
        finally:
            pyplot.close(figure)


def write_figure(figure: Any, path: Path | str, dpi: int) -> None:
    """Writes a figure whole or not at all, and closes it.

    Args:
        figure: A matplotlib figure.
        path: Picture to write; its suffix determines the format.
        dpi: Pixels per inch.

    Raises:
        OutputError: The picture cannot be written, or there is no format with this suffix.
    """
    try:
        with output_file(path) as partial:
            if partial.suffix.lower() == ".png":
                partial.write_bytes(png_of(figure, dpi))
            else:
                figure.savefig(partial, dpi=dpi)
    except ValueError as error:
        raise OutputError(path, str(error)) from error
    finally:
        load_pyplot().close(figure)
