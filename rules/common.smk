"""What all rules share: the project folder, wildcards, what a run prints at its end. No rules."""

import atexit
import gc
import logging
import os
import shlex
import sys
import tempfile
from pathlib import Path

LIBRARY = str(Path(workflow.basedir).resolve())
sys.path.insert(0, LIBRARY)

from quasi.errors import QuasiError
from quasi.export.targets import SIMULATOR_NAMES
from quasi.running.job_log import RUN_VARIABLE, read_reports
from quasi.running.job_server import JobServer, use_server
from quasi.pages.index import INDEX_TARGET, list_sources, write_index
from quasi.running.provenance import compute_code_digest, save_parsed
from quasi.project.folder import (
    check_project,
    check_settings,
    check_writable,
    read_settings,
)
from quasi.running.checksums import Checksums, read_once
from quasi.running.failed_jobs import mark_incomplete
from quasi.running.folder_contents import remember_contents
from quasi.running.ready_jobs import keep_one_timer, weigh_few
from quasi.running.rule_scripts import check_each_once
from quasi.running.live_runs import (
    explain_lock,
    refuse_unlocking,
    register_run,
    remove_stale_lock,
    withdraw_card,
)
from quasi.running.termination import replace_handler
from quasi.running.terminal import (
    FaultFilter,
    Terminal,
    format_command,
    list_up_to_date_pages,
)
from quasi.project.gaps import describe_run_code
from quasi.project.workflow import Folder

# parts of Snakemake that are no interface: where a later one has moved them, each job starts Python anew, files are
# read several times, what failed jobs leave may count as finished, and Snakemake's own handler answers SIGTERM
try:
    from snakemake.dag import ScriptProcessor
    from snakemake.io import _IOFile, is_flagged
    from snakemake.jobs import Job
    from snakemake.scheduling.job_scheduler import JobScheduler
    from snakemake.script import PythonScript
except ImportError:
    JobScheduler = PythonScript = ScriptProcessor = _IOFile = Job = None

PROJECT = os.getcwd()  # at the end of a run it is another one
FAULTS = []
STOPPED = []
TERMINALS = []
LEARN = ("reference", "compared")  # roles of flights that choose and fit
HELD = ("held out",)
# new objects from one search for unused ones to the next. Nearly all that Snakemake makes is in use until the end; with
# Python's own 700, searches take a seventh of a dry run of 1,000 flights (benchmarks/dry_run.py), and no memory is saved
COLLECTED_OBJECTS = 10_000
gc.set_threshold(COLLECTED_OBJECTS)


wildcard_constraints:
    quadrotor=r"[A-Za-z0-9_+-][A-Za-z0-9._+-]*",
    flight=r"[A-Za-z0-9_+-][A-Za-z0-9._+-]*",
    model=r"[A-Za-z0-9_+-][A-Za-z0-9._+-]*",
    campaign=r"[A-Za-z0-9_+-][A-Za-z0-9._+-]*",
    simulation=r"[A-Za-z0-9_+-][A-Za-z0-9._+-]*",
    gap=r"[A-Za-z0-9_+-][A-Za-z0-9._+-]*",
    kind="models|gaps|processing",
    asked=r"[A-Za-z0-9_+-][A-Za-z0-9._+-]*",
    gravity="withGravity|noGravity",
    simulator="|".join(SIMULATOR_NAMES),
    axis="Fx|Fy|Fz|Mx|My|Mz",


def print_reports():
    """The last line printed is the sentence that helps; before it, what was made."""
    sys.stdout.flush()
    for notice in FOLDER.places.notices if "FOLDER" in globals() else ():
        print(f"[NOTICE] {notice}", file=sys.stderr)
    for terminal in TERMINALS:
        if summary := terminal.summary():
            print(summary, flush=True)
        if terminal.idle and (pages := list_up_to_date_pages(sys.argv[1:], PROJECT)):
            print(pages, flush=True)
    for text in read_reports(os.environ[RUN_VARIABLE], "made"):
        print(text, flush=True)
    faults = FAULTS + read_reports(os.environ[RUN_VARIABLE], "errors")
    if STOPPED and not faults:
        faults = STOPPED
    for fault in dict.fromkeys(faults):
        print(f"[ERROR] {fault}", file=sys.stderr)


MAIN = RUN_VARIABLE not in os.environ

if JobScheduler is not None:
    replace_handler(JobScheduler)
    weigh_few(JobScheduler)
    keep_one_timer(JobScheduler)
    check_each_once(ScriptProcessor)

if MAIN:
    # the main process of a run; processes that it starts find the variable set
    # jobs on other computers see the project folder alone
    shared = None if workflow.local_exec or workflow.dryrun else ".snakemake/quasi"
    if shared:
        Path(shared).mkdir(parents=True, exist_ok=True)
    scratch = tempfile.TemporaryDirectory(
        prefix="quasi-run-", dir=shared and str(Path(PROJECT) / shared)
    )
    os.environ[RUN_VARIABLE] = scratch.name
    atexit.register(print_reports)
    quiet = not (workflow.output_settings.dryrun or workflow.output_settings.verbose)
    for handler in logging.getLogger("snakemake.logging").handlers:
        if handler.name == "DefaultStreamHandler":
            handler.addFilter(
                FaultFilter(
                    FAULTS,
                    lambda: FOLDER.targets(),
                    lambda: explain_lock(PROJECT, format_command(sys.argv[1:])),
                )
            )
            # a dry run is asked for Snakemake's own account; the log file of a run keeps it whole
            if quiet:
                TERMINALS.append(
                    Terminal(os.environ[RUN_VARIABLE], handler.stream, sys.argv[1:])
                )
                handler.addFilter(TERMINALS[-1])


def ask(question, *arguments):
    """Ask the folder; a fault that a user can correct stops the run with its sentence as the last line."""
    try:
        return question(*arguments)
    except QuasiError as fault:
        FAULTS.append(str(fault))
        raise WorkflowError(str(fault))
    except Exception as fault:
        FAULTS.append(
            f"the project folder could not be understood ({type(fault).__name__}: {fault}); "
            "undo your last change there, and please report this as a fault of quasi"
        )
        raise


ask(check_project, ".")
ask(check_writable, ".")

if MAIN and not workflow.output_settings.dryrun:
    if "--unlock" in sys.argv and (fault := refuse_unlocking(".")):
        FAULTS.append(fault)
        raise WorkflowError(fault)
    atexit.register(
        withdraw_card,
        register_run(Path(PROJECT), shlex.join(["snakemake", *sys.argv[1:]])),
    )
    if notice := remove_stale_lock(PROJECT):
        print(f"[NOTICE] {notice}", file=sys.stderr)

# jobs of a cluster start elsewhere
if (
    MAIN
    and PythonScript is not None
    and sys.platform == "linux"
    and workflow.local_exec
    and not workflow.output_settings.dryrun
):
    SERVER = JobServer(cores=workflow.cores)
    atexit.register(SERVER.close)
    use_server(PythonScript, SERVER)

if _IOFile is not None:
    read_once(_IOFile)
    mark_incomplete(Job)
    remember_contents(Job, is_flagged, lambda notice: announce(notice))

ask(check_settings, list(config), "--config or --configfile")
# what the command line gives (--config) comes before the folder's own file
for key, value in ask(read_settings, "config/config.yaml").items():
    config.setdefault(key, value)

FOLDER = ask(Folder, ".", config.get("data"), LIBRARY)
CHECKSUMS = Checksums(".snakemake/quasi/checksums.json")
if MAIN:
    atexit.register(CHECKSUMS.save)
    atexit.register(save_parsed)


def code(script):
    """Digest of the library code that a script reaches, so that a stage reruns when code it uses changes."""
    return compute_code_digest(f"{LIBRARY}/scripts/{script}", LIBRARY)


def contents(paths):
    """{path: SHA-256} of the files among these that a user put there: Snakemake compares times alone, and an older
    file in the place of another would go unnoticed."""
    return CHECKSUMS.compute_all(FOLDER.given(map(str, paths)))


def filtered(rows, gravity):
    return [f"results/filtered/{r.quadrotor}/{gravity}/{r.key}.parquet" for r in rows]


def announce(notice):
    """Print a notice before the first job, once, and again at the end of the run."""
    if MAIN and notice and notice not in FOLDER.places.notices:
        FOLDER.places.notices.append(notice)
        print(f"[NOTICE] {notice}", file=sys.stderr, flush=True)


def training_flights(wildcards):
    gap = ask(FOLDER.gaps.maker_of, wildcards.model)
    if gap:
        return calibrated(gap, ("compared", "reference"))
    for notice in ask(FOLDER.model_jobs.changed_selection, wildcards.model):
        announce(notice)
    return filtered(
        ask(FOLDER.logbooks.model_flights, wildcards.model, "training"),
        ask(FOLDER.configuration.gravity, wildcards.model),
    )


def calibrated(
    gap, roles=("reference", "compared", "held out"), gravity=None, kind="parquet"
):
    """Flights of a gap as processed anew; those without gravity's part named are the imported ones."""
    flights = ask(FOLDER.gaps.flights, gap)
    gravity = gravity or ask(FOLDER.gaps.gravity, gap)
    stage = "imported/{}" if gravity == "imported" else f"filtered/{{}}/{gravity}"
    return [
        f"results/calibrated/{gap}/{stage.format(r.quadrotor)}/{r.key}.{kind}"
        for role in roles
        for r in flights[role]
    ]


def as_processed(gap, roles, stage, kind="parquet"):
    """Flights of a gap before any calibration."""
    flights = ask(FOLDER.gaps.flights, gap)
    place = "imported/{}" if stage == "imported" else f"filtered/{{}}/{stage}"
    return [
        f"results/{place.format(r.quadrotor)}/{r.key}.{kind}"
        for role in roles
        for r in flights[role]
    ]


def gap_model(wildcards):
    return ask(FOLDER.gaps.model_path, wildcards.gap)


def gap_recordings(wildcards):
    asked = ask(FOLDER.gap, wildcards.gap)
    return [
        log[0] for part in ("recordings", "trained") for log in asked[part].values()
    ]


def model_sources(wildcards):
    """Of an extended model its gap's; else the identified parts, what they share, and the training flights."""
    gap = ask(FOLDER.gaps.maker_of, wildcards.model)
    if gap:
        return {"extended": f"results/parts/gap/{gap}/model.json"}
    return {
        "axes": axis_parts(wildcards),
        "shared": f"results/identified/{wildcards.model}/shared.json",
        "partition": f"results/identified/{wildcards.model}/partition.parquet",
        "flights": training_flights(wildcards),
    }


def base_of(wildcards):
    """Of an extended model the one that it extends: both are judged on the same flights."""
    gap = ask(FOLDER.gaps.maker_of, wildcards.model)
    return {"base": ask(FOLDER.gaps.model_path, gap)} if gap else {}


def partition_of(wildcards):
    gap = ask(FOLDER.gaps.maker_of, wildcards.model)
    if gap:
        return f"results/parts/gap/{gap}/partition.parquet"
    return f"results/identified/{wildcards.model}/partition.parquet"


def all_flights(wildcards):
    gap = ask(FOLDER.gaps.maker_of, wildcards.model)
    if gap:
        return calibrated(gap)
    return filtered(
        ask(FOLDER.logbooks.model_flights, wildcards.model),
        ask(FOLDER.configuration.gravity, wildcards.model),
    )


def axis_parts(wildcards):
    return [
        f"results/identified/{wildcards.model}/{a}.json"
        for a in ask(FOLDER.model_jobs.axes, wildcards.model)
    ]


def raw_files(wildcards):
    raw = ask(FOLDER.recordings.importing, wildcards.quadrotor, wildcards.flight)[
        "flight"
    ]
    # an absent file is not an input: it fails this flight's job with a sentence, not the graph of all flights
    wind = raw.get("wind", {}).get("file")
    return [raw[k] for k in ("onboard", "capture") if raw[k]] + ([wind] if wind else [])


def inspected_files(wildcards):
    """Raw files of all flights that a model, a gap or the processing names; for a gap also those that trained its model."""
    asked = ask(FOLDER.inspection, wildcards.kind, wildcards.asked)
    files = {}
    for about in asked["flights"].values():
        raw = about["settings"]["flight"]
        wind = raw.get("wind", {}).get("file")
        files |= dict.fromkeys(p for p in (raw["onboard"], raw["capture"], wind) if p)
    files |= dict.fromkeys(path for path, _ in asked.get("trained", {}).values())
    return list(files)


def row_names(wildcards, input):
    """Rows of all flights, for messages. Snakemake compares no parameter that is asked with the input, so that a moved
    row or a renamed logbook makes nothing stale."""
    return ask(FOLDER.logbooks.row_names)


def inspection_share(wildcards, input):
    """All jobs on flights that may run at once (profiles/default); none where flights are still to be made: these jobs
    would keep the inspection waiting."""
    return 1000 if len(FOLDER.given(map(str, input))) == len(input) else 0


def inspected(kind, name):
    """What the raw files hold; it is made first, and making it anew makes nothing else stale."""
    return ancient(f"results/inspected/{kind}/{name}.json")


def inspected_for_model(wildcards):
    gap = ask(FOLDER.gaps.maker_of, wildcards.model)
    return inspected("gaps", gap) if gap else inspected("models", wildcards.model)


def learning_settings(gap):
    """Settings of import and filter of the flights that a gap learns from, by key."""
    return {
        r.key: {
            "importing": ask(FOLDER.recordings.importing, r.quadrotor, r.key),
            "filtering": ask(FOLDER.recordings.filtering, r.quadrotor, r.key),
        }
        for role in LEARN
        for r in ask(FOLDER.gaps.flights, gap)[role]
    }


def learning_files(wildcards):
    """Raw files of the flights that a gap learns from: ties are settled by processing them anew."""
    made = [s["importing"]["flight"] for s in learning_settings(wildcards.gap).values()]
    winds = [raw["wind"]["file"] for raw in made if raw.get("wind", {}).get("file")]
    return [raw[k] for raw in made for k in ("onboard", "capture") if raw[k]] + winds


def simulation_files(wildcards):
    asked = ask(FOLDER.simulation, wildcards.simulation)
    return [asked[k] for k in ("model", "wind", "reference") if asked[k]]


def simulation_model(wildcards):
    return ask(FOLDER.simulation, wildcards.simulation)["model"]


def simulation_pictures(wildcards):
    parts = f"results/parts/simulation/{wildcards.simulation}"
    saved = ask(FOLDER.animation, wildcards.simulation)["save"]
    return [f"{parts}/figures"] + ([f"{parts}/animation"] if saved else [])


def model_to_export(wildcards):
    return ask(FOLDER.model_jobs.portable, wildcards.model)


def matlab_files(wildcards):
    # what the export copies as it stands: no import shows them to the digest of the code
    folder = Path(LIBRARY) / "quasi/export/matlab_files"
    return sorted(str(p) for p in folder.rglob("*") if p.is_file())


def every_model(wildcards):
    return [f"models/{m}/standalone" for m in ask(FOLDER.configuration.every_model)]


def every_processed_flight(wildcards):
    rows = ask(FOLDER.logbooks.processing_flights)
    pages = [f"results/reports/{r.quadrotor}/{r.key}.html" for r in rows]
    return filtered(rows, "withGravity") + pages


onsuccess:
    if list_sources(PROJECT):
        write_index(PROJECT, f"{PROJECT}/{INDEX_TARGET}")


onerror:
    STOPPED.append(
        "a job ended before it could say why (interrupted, killed, or out of memory; see above); "
        "nothing half-made was kept: run the same command again, with -j1 if memory is short"
    )
