"""Figures are the same files whether one process draws them or two, and what fails in any of these is raised."""

import pytest
from matplotlib.figure import Figure

from quasi.running.figure_files import write_figures


def drawn(height):
    figure = Figure(figsize=(2, 1))
    figure.subplots().plot([0.0, height])
    return figure


def test_two_processes_write_the_files_of_one(tmp_path):
    drawings = {str(n): (lambda n=n: drawn(n)) for n in range(5)} | {"none": lambda: None, "made": drawn(9.0)}
    for processes in (1, 2, 9):
        write_figures(drawings, tmp_path / str(processes), processes)
    files = {p.name: p.read_bytes() for p in (tmp_path / "1").iterdir()}
    assert set(files) == {f"{n}.png" for n in [*range(5), "made"]}
    for processes in "29":
        assert {p.name: p.read_bytes() for p in (tmp_path / processes).iterdir()} == files


@pytest.mark.parametrize("place", [0, 1])
def test_what_a_drawing_raises_is_raised(tmp_path, place):
    def fail():
        raise ValueError("no such panel")

    drawings = {"0": lambda: drawn(0.0), "1": lambda: drawn(1.0)} | {str(place): fail}
    with pytest.raises(ValueError, match="no such panel"):
        write_figures(drawings, tmp_path, 2)
