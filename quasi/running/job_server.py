"""A process that has imported the libraries of the jobs, and is forked for each of them.

A job on one flight computes for less than a second, but Python needs a second and more to import NumPy, SciPy, pandas
and Numba. The server imports them once per run, while Snakemake still builds its graph of jobs. It has one thread, so
that a fork is safe. Linux only; elsewhere, and for jobs that ask for their own environment, each job starts Python.
"""

import gc
import importlib
import json
import os
import runpy
import select
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext, suppress
from typing import Any

MAX_REQUEST = 1 << 17  # bytes of a request, nearly all of it the environment; Linux allows 208 kB in a packet
REPLY = 16  # bytes; a process number or an exit code in decimal
THREAD_VARIABLES = (
    "OMP_NUM_THREADS",
    "GOTO_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "VECLIB_MAXIMUM_THREADS",
    "NUMEXPR_NUM_THREADS",
)  # those that Snakemake sets for a job
# what most jobs import; a job imports the rest itself
PRELOADED = (
    "snakemake.iocontainers",
    "snakemake.io",
    "snakemake.logging",
    "pyarrow.parquet",
    "scipy.signal",
    "scipy.optimize",
    "quasi.filtering.flight",
    "quasi.identification.fit",
    "quasi.importing.flight",
    "quasi.project.logbook",
    "quasi.running.job_log",
)


class Job:
    """A running job of the server. pid  its process"""

    def __init__(self, channel: socket.socket, pid: int):
        self._channel, self.pid = channel, pid

    def wait(self) -> int:
        """Wait for the end of the job; return its exit code, or minus the signal that ended it."""
        with self._channel:
            reply = self._channel.recv(REPLY)
        return int(reply) if reply else -signal.SIGKILL  # the server itself was ended


class JobServer:
    """The server as the main process of a run sees it. modules  names of what it imports"""

    def __init__(self, modules: Sequence[str] = PRELOADED):
        self._control, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._lock = threading.Lock()
        program = f"from quasi.running.job_server import serve; serve({theirs.fileno()}, {list(modules)!r})"
        environment = os.environ | dict.fromkeys(THREAD_VARIABLES, "1")
        with theirs:
            self._process = subprocess.Popen(
                [sys.executable, "-P", "-c", program], pass_fds=[theirs.fileno()], env=environment
            )

    def start(self, script: str, environment: Mapping[str, str]) -> Job | None:
        """Start a script in the current folder; None where the server cannot do it."""
        request = json.dumps({"script": script, "folder": os.getcwd(), "environment": dict(environment)}).encode()
        if len(request) > MAX_REQUEST:
            return None
        channel, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        try:
            with theirs, self._lock:
                socket.send_fds(self._control, [request], [theirs.fileno()])
            reply = channel.recv(REPLY)
        except OSError:
            reply = b""
        if not reply:
            channel.close()
            return None
        return Job(channel, int(reply))

    def close(self) -> None:
        """End the server; no job is running any more."""
        self._control.close()
        self._process.terminate()
        self._process.wait()


def serve(descriptor: int, modules: Sequence[str]) -> None:
    """Run the server until the main process closes its end of the control socket. Each job returns from here too."""
    control = socket.socket(fileno=descriptor)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the jobs by themselves
    for module in modules:
        importlib.import_module(module)
    gc.collect()
    gc.freeze()
    woken, waker = os.pipe()
    os.set_blocking(waker, False)
    signal.set_wakeup_fd(waker, warn_on_full_buffer=False)
    signal.signal(signal.SIGCHLD, lambda *_: None)
    running: dict[int, socket.socket] = {}
    while True:
        ready, _, _ = select.select([control, woken], [], [])
        if woken in ready:
            os.read(woken, 4096)
            _report_ended(running)
        if control not in ready:
            continue
        request, descriptors, _, _ = socket.recv_fds(control, MAX_REQUEST, 1)
        if not request:
            break
        channel = socket.socket(fileno=descriptors[0])
        pid = os.fork()
        if pid == 0:
            signal.set_wakeup_fd(-1)
            for open_socket in (control, channel, *running.values()):
                open_socket.close()
            os.close(woken)
            os.close(waker)
            _run(json.loads(request))
            return
        with suppress(OSError):
            channel.send(str(pid).encode())
        running[pid] = channel
    for pid in running:
        with suppress(ProcessLookupError):
            os.kill(pid, signal.SIGTERM)


def _report_ended(running: dict[int, socket.socket]) -> None:
    while running:
        pid, status = os.waitpid(-1, os.WNOHANG)
        if pid == 0:
            return
        with running.pop(pid) as channel, suppress(OSError):  # the main process may have ended
            channel.send(str(os.waitstatus_to_exitcode(status)).encode())


def _run(request: Mapping[str, Any]) -> None:
    signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)
    os.environ.clear()
    os.environ.update(request["environment"])
    os.chdir(request["folder"])
    script = os.path.abspath(request["script"])
    sys.argv = [script]
    sys.path.insert(0, os.path.dirname(script))
    runpy.run_path(script, run_name="__main__")


def use_server(scripts: type, server: JobServer, measure: Callable[..., Any]) -> None:
    """Let a class of Snakemake (`PythonScript`) run its scripts in the server.

    measure  context manager of a process number and a record, `snakemake.benchmark.benchmarked`
    """
    original = scripts.execute_script  # type: ignore[attr-defined]

    def execute_script(self: Any, fname: str, edit: bool = False) -> None:
        special = edit or self.threads != 1 or self.conda_env or self.container_img or self.env_modules
        environment = os.environ | dict.fromkeys(THREAD_VARIABLES, "1")
        if folder := self.resources.get("tmpdir"):
            environment |= dict.fromkeys(("TMPDIR", "TMP", "TEMPDIR", "TEMP"), str(folder))
        job = None if special else server.start(fname, environment)
        if job is None:
            original(self, fname, edit)
            return
        with nullcontext() if self.bench_record is None else measure(job.pid, self.bench_record):
            code = job.wait()
        if code:
            raise subprocess.CalledProcessError(code, f"{sys.executable} {fname}")

    scripts.execute_script = execute_script  # type: ignore[attr-defined]
