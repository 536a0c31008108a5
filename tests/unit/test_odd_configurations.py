"""No configuration ends in a traceback: documents and logbook rows with odd values give a result or one sentence."""

import csv
import functools
import io
import json
import shutil
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from quasi.errors import QuasiError
from quasi.identification.candidates import read_specification
from quasi.project.workflow import Folder
from quasi_synthesis.campaign import quadrotor_configuration, read_campaign

ROOT = Path(__file__).parents[2]
LOGBOOK = "data/example_file_log.csv"
POOL = "config/polynomials/physical.json"  # of the example
DOCUMENTS = (
    "config/processing.json", "config/models/example.json", "config/gaps/example.json",
    "config/simulations/example.json", "config/synthesis/example.json", "data/MadeBeetleConfig.json", POOL,
)  # fmt: skip
ODD = st.one_of(
    st.sampled_from(
        [None, True, False, "", " ", "nan", "1e400", "0", "../..", "/", "a/b", ".", "x" * 5000, "\x00", "\u202e", "2-"]
    ),
    st.sampled_from([0, -1, 1, 2, 10**30, -(10**30), 1e308, 5e-324, 0.5, [], {}, [[]], [None], [1, 2, 3], {"": {}}]),
    st.integers(),
    st.floats(allow_nan=True, allow_infinity=True),
    st.text(max_size=6),
    st.recursive(st.none() | st.integers(-3, 9) | st.text(max_size=3), lambda x: st.lists(x, max_size=3), max_leaves=4),
)  # fmt: skip


@pytest.fixture(scope="module")
def project(tmp_path_factory):
    """A folder with the example's configuration; raw files exist and are empty."""
    root = tmp_path_factory.mktemp("odd") / "project"
    for name in ("config", "data"):
        shutil.copytree(ROOT / name, root / name, ignore=shutil.ignore_patterns("schemas", "raw"))
    return root


def places(document, path=()):
    """Paths of all values of a document, the containers included."""
    found = [path] if path else []
    items = (
        document.items() if isinstance(document, dict) else enumerate(document) if isinstance(document, list) else ()
    )
    for key, value in items:
        found += places(value, (*path, key))
    return found


def changed(document, data):
    """The document with one to three values replaced, removed, renamed or wrapped."""
    document = json.loads(json.dumps(document))
    for _ in range(data.draw(st.integers(1, 3))):
        known = places(document)
        if not known:
            break
        *way, last = data.draw(st.sampled_from(known))
        parent = document
        for key in way:
            parent = parent[key]
        act = data.draw(st.sampled_from(["replace", "replace", "replace", "remove", "rename", "wrap"]))
        if act == "replace":
            parent[last] = data.draw(ODD)
        elif act == "remove":
            del parent[last]
        elif act == "rename" and isinstance(parent, dict):
            parent[data.draw(st.text(max_size=8))] = parent.pop(last)
        else:
            parent[last] = [parent[last]]
    return document


@functools.cache
def quadrotor_of(campaign):
    """The quadrotor of a campaign's text: most documents leave the campaign as it is, and a flight at rest is slow."""
    return quadrotor_configuration(read_campaign(json.loads(campaign), "example"))


def questions(root):
    """All that rules and jobs ask of a folder's configuration, each as a function without arguments."""
    folder = Folder(root)
    jobs = folder.model_jobs
    yield folder.targets
    yield folder.configured_work
    yield lambda: folder.configuration.every_model
    yield folder.logbooks.processing_flights
    name = "example"
    for ask in (
        jobs.identification, jobs.partitioning, jobs.isolation, jobs.trajectories, jobs.roles, jobs.standalone,
        jobs.portable, jobs.matlab, jobs.changed_selection, folder.gap, folder.gaps.model_path, folder.gaps.flights,
        folder.gaps.roles, folder.simulation, folder.animation, folder.configuration.gravity,
    ):  # fmt: skip
        yield lambda ask=ask: ask(name)
    yield lambda: [jobs.axis(name, axis) for axis in jobs.axes(name)]
    yield lambda: [folder.inspection(kind, name) for kind in ("models", "gaps", "processing")]
    yield lambda: [
        (ask(r.quadrotor, r.key), folder.recordings.mass(r))
        for r in folder.logbooks.processing_flights()
        for ask in (folder.recordings.importing, folder.recordings.filtering)
    ]

    yield lambda: quadrotor_of(json.dumps(folder.configuration.campaign("example")))
    for axis in ("Fx", "Mz"):
        yield lambda axis=axis: read_specification(jobs.specification("example")[1], axis, POOL)


def check(root):
    """Every question gets an answer or a QuasiError of one sentence that ends where its text does."""
    for ask in questions(root):
        try:
            ask()
        except QuasiError as error:
            assert str(error).strip() and "Traceback" not in str(error)


SETTINGS = settings(
    max_examples=10, deadline=None, derandomize=True, suppress_health_check=[HealthCheck.function_scoped_fixture]
)


@pytest.mark.parametrize("path", DOCUMENTS)
@SETTINGS
@given(data=st.data())
def test_an_odd_document_is_answered_in_sentences(project, path, data):
    original = (project / path).read_text()
    try:
        (project / path).write_text(json.dumps(changed(json.loads(original), data)))
        check(project)
    finally:
        (project / path).write_text(original)


@SETTINGS
@given(data=st.data())
def test_odd_cells_of_a_logbook_are_answered_in_sentences(project, data):
    original = (project / LOGBOOK).read_text()
    rows = list(csv.reader(io.StringIO(original)))
    for _ in range(data.draw(st.integers(1, 3))):
        row = data.draw(st.sampled_from(range(len(rows))))
        column = data.draw(st.sampled_from(range(len(rows[row]))))
        value = data.draw(ODD)
        rows[row][column] = value if isinstance(value, str) else json.dumps(value)
    text = io.StringIO()
    csv.writer(text).writerows(rows)
    try:
        (project / LOGBOOK).write_text(text.getvalue(), encoding="utf-8", errors="surrogatepass")
        check(project)
    finally:
        (project / LOGBOOK).write_text(original)
