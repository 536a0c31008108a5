"""The page on pictures: its examples run as they stand."""

import re
from pathlib import Path

import numpy as np
import pandas as pd
from PIL import Image

from quasi.tables import write_table

ROOT = Path(__file__).parents[2]


def test_the_examples_of_the_page_run_in_order(tmp_path, monkeypatch):
    text = (ROOT / "docs" / "pictures.md").read_text(encoding="utf-8")
    blocks = re.findall(r"```python\n(.*?)```", text, flags=re.S)
    assert len(blocks) == 3
    t = np.arange(11.5, 22.5, 0.1)
    flight = pd.DataFrame({"t": t, "x": np.sin(t), "y": np.cos(t), "z": -1 - 0.05 * t})
    flight[["roll", "pitch", "yaw"]] = 0.1
    flight[["w1", "w2", "w3", "w4"]] = 2000.0
    folder = tmp_path / "results/filtered/MadeBeetle/withGravity"
    folder.mkdir(parents=True)
    write_table(folder / "example-07.parquet", flight)
    (tmp_path / "data").mkdir()
    (tmp_path / "data/MadeBeetleConfig.json").write_bytes((ROOT / "data/MadeBeetleConfig.json").read_bytes())
    monkeypatch.chdir(tmp_path)
    names: dict = {}
    for block in blocks:
        # fewer frames, the rest as written
        exec(block.replace("fps=25", "fps=2").replace("fps=10", "fps=1"), names)
    for name in ("trajectory.png", "snapshots.png", "both.png", "flight.gif", "close.gif", "panel.gif"):
        with Image.open(tmp_path / name) as image:
            assert image.size[0] > 300
