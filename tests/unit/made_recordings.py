"""Made flights as raw files."""

from quasi.tables import write_bytes, write_text


def written(folder, key, made):
    """Write a made flight's raw files into a folder; what an import job is told of them."""
    onboard, capture = folder / f"{key}.bbl", folder / f"{key}.csv"
    write_bytes(onboard, made.onboard)
    write_text(capture, made.capture)
    return {
        "flight": key, "quadrotor": "Made", "flight controller": "betaflight", "rigid body": "MadeBeetle",
        "onboard": str(onboard), "capture": str(capture), "log number": None,
    }  # fmt: skip
