"""Figure of a reachable set: its hull in space, from above, from behind and from the side."""

import numpy as np
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d.art3d import Poly3DCollection

from quasi.pages.drawing import make_axes, set_limits
from quasi.simulation.tools.reach import Reach, find_hull

HALF_COLOUR, WHOLE_COLOUR = "C1", "C0"
# horizontal and vertical axis of each plane; height upwards, so that up is up
_PLANES = ((1, 0, "east y, m", "north x, m"), (1, 2, "east y, m", "height -z, m"), (0, 2, "north x, m", "height -z, m"))


def draw_reach(found: Reach) -> Figure:
    """Draw the reached positions at half the horizon and at the horizon, with their hulls."""
    horizon = float(found.t[-1])
    figure = Figure(figsize=(11, 9), layout="constrained")
    figure.suptitle(f"{found.setup.name}: reached within {horizon:g} s, {len(found.targets)} targets")
    sets = [
        (found.at(0.5 * horizon), HALF_COLOUR, f"{0.5 * horizon:g} s"),
        (found.at(horizon), WHOLE_COLOUR, f"{horizon:g} s"),
    ]
    start = found.setup.start[10:13]
    space = make_axes(figure, (2, 2, 1))
    everywhere = np.vstack([start[None], *(points for points, _, _ in sets)])
    for points, colour, _ in sets:
        shape = find_hull(points)
        if shape is not None:
            faces = Poly3DCollection(points[shape.simplices], facecolor=colour, edgecolor=colour, alpha=0.15, lw=0.4)
            space.add_collection3d(faces)
    space.plot(*found.at(horizon).T, ".", color=WHOLE_COLOUR, ms=3)
    space.plot(*start[:, None], "k+", ms=8)
    set_limits(space, everywhere.min(axis=0), everywhere.max(axis=0))
    for place, (a, b, across, up) in enumerate(_PLANES, start=2):
        axes = figure.add_subplot(2, 2, place)
        sign = -1.0 if b == 2 else 1.0
        for points, colour, label in sets:
            flat = np.column_stack([points[:, a], sign * points[:, b]])
            axes.plot(*flat.T, ".", color=colour, ms=3, label=f"after {label}")
            edge = find_hull(flat)
            if edge is not None:
                around = np.append(edge.vertices, edge.vertices[0])
                axes.plot(*flat[around].T, color=colour, lw=1.0)
        axes.plot(start[a], sign * start[b], "k+", ms=8, label="start")
        axes.set(xlabel=across, ylabel=up, aspect="equal")
        axes.grid(alpha=0.3)
    axes.legend(loc="upper right", fontsize="small")
    return figure
