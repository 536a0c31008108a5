"""A PlotJuggler layout of a recording: one tab per group of signals, every vehicle's curve in the same plot.

Source of the format: layouts that PlotJuggler 3 writes (root, tabbed_widget, Tab, Container, DockSplitter, DockArea,
plot, curve). A curve is named by its topic and field.
"""

from collections.abc import Sequence

from quasi.export.mcap.vehicles import Vehicle
from quasi.export.xml_text import attribute

MOST_PLOTS = 6  # in a tab; more are too low to read


def layout_text(vehicles: Sequence[Vehicle]) -> str:
    """The layout as XML."""
    lines = [
        "<?xml version='1.0' encoding='UTF-8'?>",
        "<root>",
        ' <tabbed_widget name="Main Window" parent="main_window">',
    ]
    for group in dict.fromkeys(g for v in vehicles for g in v.signals):
        names = list(dict.fromkeys(n for v in vehicles if group in v.signals for n in v.signals[group]))
        for first in range(0, len(names), MOST_PLOTS):
            shown = names[first : first + MOST_PLOTS]
            title = group if len(names) <= MOST_PLOTS else f"{group} {first // MOST_PLOTS + 1}"
            lines += _tab(title, group, shown, vehicles)
    return "\n".join([*lines, ' <currentTabIndex index="0"/>', " </tabbed_widget>", "</root>", ""])


def _tab(title: str, group: str, names: Sequence[str], vehicles: Sequence[Vehicle]) -> list[str]:
    sizes = ";".join([f"{1.0 / len(names):.6f}"] * len(names))
    lines = [
        f'  <Tab tab_name={attribute(title)} containers="1">', "   <Container>",
        f'    <DockSplitter orientation="-" count="{len(names)}" sizes="{sizes}">',
    ]  # fmt: skip
    for name in names:
        lines += ['     <DockArea name="...">', '      <plot style="Lines" mode="TimeSeries">', "       <limitY/>"]
        for vehicle in vehicles:
            if name in vehicle.signals.get(group, ()):
                curve = attribute(f"/{vehicle.name}/{group}/{name}")
                color = "#" + "".join(f"{round(255 * c):02x}" for c in vehicle.color)
                lines.append(f'       <curve name={curve} color="{color}"/>')
        lines += ["      </plot>", "     </DockArea>"]
    return [*lines, "    </DockSplitter>", "   </Container>", "  </Tab>"]
