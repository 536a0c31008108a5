"""A process that has imported the libraries of the jobs, and is forked for each of them.

A job on one flight computes for less than a second, but Python needs a second and more to import NumPy, SciPy, pandas
and Numba. The server imports them once per run, while Snakemake still builds its graph of jobs. It has one thread, so
that a fork is safe. Linux only; elsewhere, and for jobs that ask for their own environment, each job starts Python.

Jobs of a room with kernels are forked from a process of that room, itself a fork of the server. It compiles the kernels
or loads them from the cache; until then its jobs wait. So no two jobs compile the same kernel, and no job loads one.
With the first job of a room, the rooms behind it prepare themselves on another core.
"""

import atexit
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
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import Any

MAX_REQUEST = 1 << 17  # bytes of a request, nearly all of it the environment; Linux allows 208 kB in a packet
REPLY = 256  # bytes; a process number in decimal, or an exit code and what the job used as JSON
# rooms with kernels, in the order in which a flight passes them
ROOMS = ("quasi_synthesis", "quasi.importing", "quasi.filtering", "quasi.identification")
ROOM_OF_SCRIPT = {
    "synthesis.py": "quasi_synthesis",
    "inspection.py": "quasi.importing",
    "importing.py": "quasi.importing",
    "gap_importing.py": "quasi.importing",
    "filtering.py": "quasi.filtering",
    "gap_filtering.py": "quasi.filtering",
    "identification_shared.py": "quasi.identification",
    "gap_calibration.py": "quasi.filtering",
    "gap_diagnosis.py": "quasi.filtering",
}
THREAD_VARIABLES = (
    "OMP_NUM_THREADS",
    "GOTO_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "VECLIB_MAXIMUM_THREADS",
    "NUMEXPR_NUM_THREADS",
)  # those that Snakemake sets for a job
# bytes of an array that the C library (glibc) takes from the kernel by itself and gives back when it is freed. Its own
# limit, 128 kB, is less than a column of a flight: the kernel would clear new pages for each intermediate result, a
# tenth of what a job computes. Half the memory that a job may use (benchmarks/batch.py) is never given back so.
KEPT_BYTES = 1 << 29
MALLOC_VARIABLES = ("MALLOC_MMAP_THRESHOLD_", "MALLOC_TRIM_THRESHOLD_")
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
    """A running job of the server. pid  its process; used  at its end: processor s, memory, read and written MiB,
    as the kernel counted them, those of its own processes that it waited for included"""

    def __init__(self, channel: socket.socket, pid: int):
        self._channel, self.pid = channel, pid
        self.used: dict[str, float] = {}

    def wait(self) -> int:
        """Wait for the end of the job; return its exit code, or minus the signal that ended it."""
        with self._channel:
            reply = self._channel.recv(REPLY)
        if not reply:
            return -signal.SIGKILL  # the server itself was ended
        self.used = json.loads(reply)
        return int(self.used.pop("code"))


class JobServer:
    """The server as the main process of a run sees it.

    modules  names of what it imports; cores  with more than one, later rooms prepare themselves ahead of their jobs
    """

    def __init__(self, modules: Sequence[str] = PRELOADED, cores: int = 1):
        self._control, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._lock = threading.Lock()
        self._rooms: dict[str, socket.socket] = {}
        self._cores = cores
        program = f"from quasi.running.job_server import serve; serve({theirs.fileno()}, {list(modules)!r})"
        environment = dict.fromkeys(MALLOC_VARIABLES, str(KEPT_BYTES)) | os.environ
        environment |= dict.fromkeys(THREAD_VARIABLES, "1")
        with theirs:
            self._process = subprocess.Popen(
                [sys.executable, "-P", "-c", program], pass_fds=[theirs.fileno()], env=environment
            )

    def start(self, script: str, environment: Mapping[str, str], room: str | None = None) -> Job | None:
        """Start a script in the current folder; None where the server cannot do it. room  one of ROOMS"""
        request = json.dumps({"script": script, "folder": os.getcwd(), "environment": dict(environment)}).encode()
        if len(request) > MAX_REQUEST:
            return None
        channel, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        try:
            with theirs, self._lock:
                control = self._open(room) if room else self._control
                socket.send_fds(control, [request], [theirs.fileno()])
            reply = channel.recv(REPLY)
        except OSError:
            reply = b""
        if not reply:
            channel.close()
            return None
        return Job(channel, int(reply))

    def _open(self, room: str) -> socket.socket:
        """Find the control socket of a room; with its first job, its process starts, and one for the later rooms."""
        if room not in self._rooms:
            later = [name for name in ROOMS[ROOMS.index(room) + 1 :] if name not in self._rooms]
            for rooms in ([room], later if self._cores > 1 else []):
                if not rooms:
                    continue
                pairs = [socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET) for _ in rooms]
                self._rooms |= {name: ours for name, (ours, _) in zip(rooms, pairs)}
                theirs = [end for _, end in pairs]
                socket.send_fds(self._control, [json.dumps({"rooms": rooms}).encode()], [s.fileno() for s in theirs])
                for end in theirs:
                    end.close()
        return self._rooms[room]

    def close(self) -> None:
        """End the server; no job is running any more."""
        for control in (self._control, *self._rooms.values()):
            control.close()
        if not self._rooms:
            self._process.terminate()  # it may still be importing
        self._process.wait()


def serve(descriptor: int, modules: Sequence[str]) -> None:
    """Run the server until the main process closes its end of the control socket. Each job returns from here too."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the jobs by themselves
    gc.disable()  # what is imported stays
    for module in modules:
        importlib.import_module(module)
    gc.enable()
    _serve(socket.socket(fileno=descriptor))


def _serve(control: socket.socket, rooms: Sequence[int] = ()) -> None:
    """Serve until the control socket closes or SIGTERM. rooms  processes that end with this one"""
    gc.collect()
    gc.freeze()
    woken, waker = os.pipe()
    os.set_blocking(waker, False)
    signal.set_wakeup_fd(waker, warn_on_full_buffer=False)
    stopped: list[int] = []
    signal.signal(signal.SIGCHLD, lambda *_: None)
    signal.signal(signal.SIGTERM, lambda number, _: stopped.append(number))
    running: dict[int, socket.socket | None] = dict.fromkeys(rooms)  # jobs; of a room nobody waits for the end
    while not stopped:
        ready, _, _ = select.select([control, woken], [], [])
        if woken in ready:
            os.read(woken, 4096)
            _report_ended(running)
        if control not in ready or stopped:
            continue
        message, descriptors, _, _ = socket.recv_fds(control, MAX_REQUEST, len(ROOMS))
        if not message:
            break
        request = json.loads(message)
        channels = [socket.socket(fileno=descriptor) for descriptor in descriptors]
        pid = _fork()
        if pid == 0:
            for open_socket in (control, *running.values()):
                if open_socket:
                    open_socket.close()
            os.close(woken)
            os.close(waker)
            if "rooms" in request:
                _prepare(request["rooms"], channels)
            else:
                channels[0].close()
                _run(request)
            return
        if "rooms" in request:
            running[pid] = None
            for channel in channels:
                channel.close()
        else:
            with suppress(OSError):
                channels[0].send(str(pid).encode())
            running[pid] = channels[0]
    for pid in running:
        with suppress(ProcessLookupError):
            os.kill(pid, signal.SIGTERM)
    for pid, channel in running.items():
        if channel is None:  # a room; its jobs' times count as the main process's
            with suppress(ChildProcessError):
                os.waitpid(pid, 0)


def _fork() -> int:
    """Fork a process that SIGTERM ends; a signal that arrives meanwhile waits until it does."""
    signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGTERM])
    pid = os.fork()
    if pid == 0:
        signal.set_wakeup_fd(-1)
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, [signal.SIGTERM])
    return pid


def _prepare(rooms: Sequence[str], controls: Sequence[socket.socket]) -> None:
    """Compile or load the kernels of the first room and serve its jobs; a fork does so for the rooms behind it."""
    with suppress(Exception):  # then its jobs compile them, and report what is wrong
        importlib.import_module(f"{rooms[0]}.kernels").compile_kernels()
    later = _fork() if len(rooms) > 1 else None
    if later == 0:
        controls[0].close()
        _prepare(rooms[1:], controls[1:])
        return
    for control in controls[1:]:
        control.close()
    _serve(controls[0], [later] if later else [])


def _report_ended(running: dict[int, socket.socket | None]) -> None:
    while running:
        pid, status, usage = os.wait4(-1, os.WNOHANG)
        if pid == 0:
            return
        channel = running.pop(pid, None)
        if channel is None:
            continue
        report = {
            "code": os.waitstatus_to_exitcode(status), "processor": usage.ru_utime + usage.ru_stime,
            "memory": usage.ru_maxrss / 1024.0, "read": usage.ru_inblock / 2048.0, "written": usage.ru_oublock / 2048.0,
        }  # fmt: skip
        with channel, suppress(OSError):  # the main process may have ended
            channel.send(json.dumps(report).encode())


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
    # the interpreter's own end would write to, and so copy, nearly all memory that the job shares with its server
    atexit._run_exitfuncs()
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(0)


def use_server(scripts: type, server: JobServer) -> None:
    """Let a class of Snakemake (`PythonScript`) run its scripts in the server.

    A rule's benchmark file is written from what the kernel counted of the job. Snakemake itself walks through a job's
    memory every half second, and misses what the job uses after the last time.
    """
    original = scripts.execute_script  # type: ignore[attr-defined]

    def execute_script(self: Any, fname: str, edit: bool = False) -> None:
        special = edit or self.conda_env or self.container_img or self.env_modules
        environment = os.environ | dict.fromkeys(THREAD_VARIABLES, "1")
        if folder := self.resources.get("tmpdir"):
            environment |= dict.fromkeys(("TMPDIR", "TMP", "TEMPDIR", "TEMP"), str(folder))
        room = ROOM_OF_SCRIPT.get(os.path.basename(fname).rpartition(".py")[0].rpartition(".")[2] + ".py")
        job = None if special else server.start(fname, environment, room)
        if job is None:
            original(self, fname, edit)
            return
        began = time.time()
        code = job.wait()
        if self.bench_record is not None:
            _fill(self.bench_record, time.time() - began, job.used)
        if code:
            raise subprocess.CalledProcessError(code, f"{sys.executable} {fname}")

    scripts.execute_script = execute_script  # type: ignore[attr-defined]


def _fill(record: Any, seconds: float, used: Mapping[str, float]) -> None:
    """Write what a job used into Snakemake's record of a benchmark; what is not counted stays open."""
    record.running_time = seconds
    if not used:
        return
    record.data_collected = True
    record.cpu_time, record.cpu_usage = used["processor"], 100.0 * used["processor"]
    record.max_rss, record.io_in, record.io_out = used["memory"], used["read"], used["written"]
