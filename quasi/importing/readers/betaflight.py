"""Logs of Betaflight and INDIflight: blackbox files, and the CSV that other programs decode from them."""

from collections.abc import Callable

from quasi.airframe import number
from quasi.errors import ReadError, quoted
from quasi.importing.checks.body_axes import settle_body_axes
from quasi.importing.readers.blackbox import read_blackbox
from quasi.importing.readers.decoded import read_decoded
from quasi.importing.readers.reader import TEXT, Reader, Request
from quasi.importing.series import Recording
from quasi.project.recognition import HEAD_SIZE, MARKER
from quasi.tables import read_bytes

COUNTS = "betaflight raw acceleration correction factor"
BLACKBOX_SUFFIXES = (".bbl", ".bfl")


def _read_text(request: Request) -> Recording:
    """A decoded CSV, or a blackbox file without its first header lines."""
    path = request.path
    data = read_bytes(path)
    if MARKER in data or (path.suffix.lower() in BLACKBOX_SUFFIXES and b"gyroADC" not in data[:HEAD_SIZE]):
        return _read_blackbox(request)
    if (request.log_number or 1) > 1:
        raise ReadError(
            f"{path} is no blackbox file of several logs, but the logbook asks for log {request.log_number}; "
            "give the .bbl, or each log's own file and no 'Log number'"
        )
    return read_decoded(path, poles=request.poles, counts=number(request.quadrotor, COUNTS, str(path)))


def _read_blackbox(request: Request) -> Recording:
    return read_blackbox(request.path, log_number=request.log_number, poles=request.poles)


def _with_body_axes(read: Callable[[Request], Recording]) -> Callable[[Request], Recording]:
    """A reader that also brings body axes to FRD, and refuses a log that is not from the firmware in the logbook."""

    def read_in_body_axes(request: Request) -> Recording:
        recording, path = read(request), request.path
        revision = recording.metadata["firmware"]["revision"]
        from_indiflight = recording.metadata["body axes logged"].endswith("down")
        if request.controller == "indiflight" and not from_indiflight:
            raise ReadError(
                f"{path} is not from INDIflight: it names the firmware {quoted(revision)} and holds neither its quat "
                "nor its omega fields, and body axes would be mixed up; correct 'Flight controller' in the logbook"
            )
        if request.controller != "indiflight" and from_indiflight:
            recording.notes.append(
                f"{path} comes from INDIflight and is read as such; the logbook says '{request.controller}'"
            )
        return settle_body_axes(recording, request.quadrotor, str(path))

    return read_in_body_axes


_FIRMWARE = ("betaflight", "indiflight", "cleanflight")
BLACKBOX_READER = Reader("a blackbox log (.bbl, .bfl)", ("blackbox",), _with_body_axes(_read_blackbox), _FIRMWARE)
DECODED_READER = Reader("its decoded CSV", (TEXT, "gzip"), _with_body_axes(_read_text), _FIRMWARE)
