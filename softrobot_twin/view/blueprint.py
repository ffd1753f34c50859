"""How a viewer lays the picture out: space on the left, curves on the right.

Importing this module imports rerun.
"""

from __future__ import annotations

import rerun.blueprint as rrb

from softrobot_twin.view import picture
from softrobot_twin.view.recording import past_range, time_panel
from softrobot_twin.view.slide_curves import SLIDE_PLOT
from softrobot_twin.view.touch import CONTACT_PLOT

# How much of the past the curves show [s].
_PLOTTED_PAST = 20.0


def layout(robot_name: str, with_contact: bool = False, with_slides: bool = False) -> rrb.Blueprint:
    """Lay out one robot's picture.

    Args:
        robot_name: Title of the view of space.
        with_contact: Whether there is contact to plot.
        with_slides: Whether there are slides to plot.
    """
    space = rrb.Spatial3DView(origin="/", name=robot_name,
                              contents=["/robot/**", "/targets/**", "/markers/**",
                                        "/rigid_bodies/**", "/obstacles/**", "/contacts/**"])
    status = rrb.TextLogView(origin=picture.STATUS, name="Status")
    more = [_plot("Slides", SLIDE_PLOT)] if with_slides else []
    if with_contact:
        more.append(_plot("Contacts", CONTACT_PLOT))
    curves = rrb.Vertical(
        _plot("Effector error [mm]", picture.ERROR_PLOT),
        _plot("Cable lengths [mm]", picture.LENGTH_PLOT),
        _plot("Cable tensions [N]", picture.TENSION_PLOT),
        *more,
        _plot("Times [ms]", picture.TIME_PLOT),
        _plot("Residual [N]", picture.RESIDUAL_PLOT, legend=False),
        row_shares=[1.0] * (3 + len(more)) + [1.2, 0.8])
    return rrb.Blueprint(
        rrb.Horizontal(rrb.Vertical(space, status, row_shares=[6.0, 1.0]), curves,
                       column_shares=[3.0, 2.0]),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        time_panel())


def _plot(title: str, origin: str, legend: bool = True) -> rrb.TimeSeriesView:
    return rrb.TimeSeriesView(origin=origin, name=title, time_ranges=past_range(_PLOTTED_PAST),
                              plot_legend=rrb.PlotLegend(rrb.Corner2D.LeftTop, visible=legend))
