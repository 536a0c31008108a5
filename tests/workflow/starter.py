"""A process that has imported Snakemake and starts every run as a fork of itself: four seconds less for each.

Imports of others take most of a dry run's time, and of the start of a run's job server, which is another fork. The
library is not among them: every run and every server reads it anew. The nano-drone test starts Python instead.
Requests are lines of JSON on standard input. The answer to a run is its exit code. To a run in a session of its own it
is the process number; asked with that, the answer is the exit code, or null while the run goes on.
"""

import atexit
import gc
import json
import os
import signal
import socket
import subprocess
import sys
import threading

# what runs and jobs import besides the library
import jsonschema  # noqa: F401
import matplotlib.backends.backend_agg  # noqa: F401
import nbformat  # noqa: F401
import numba
import pandas  # noqa: F401
import pyarrow.parquet  # noqa: F401
import scipy.optimize
import scipy.signal
import scipy.spatial.transform  # noqa: F401
import smart_open  # noqa: F401
import snakemake.cli
import snakemake.report.html_reporter
import snakemake.storage
import tqdm  # noqa: F401

snakemake.cli.get_argument_parser()  # it looks for plugins, and keeps what it finds

JOB_SERVER = "from quasi.running.job_server import serve;"  # the program of `quasi.running.job_server.JobServer`
REQUEST = 1 << 17  # bytes, nearly all of it the environment


def serve():
    """Answer requests until the input ends; returns the request in the forked process that shall run it, else None."""
    gc.collect()
    gc.freeze()
    for line in sys.stdin:
        request = json.loads(line)
        own_session = request.get("own session", False)
        process = request.get("ended") or os.fork()
        if process == 0:
            if own_session:
                os.setsid()
                print(os.getpid(), flush=True)
            return request
        if not own_session:
            ended, status = os.waitpid(process, os.WNOHANG if "ended" in request else 0)
            print(os.waitstatus_to_exitcode(status) if ended else "null", flush=True)
    return None


class ForkedServer:
    """The process of a job server as `subprocess.Popen` gives it: a fork that waits for its program."""

    def __init__(self):
        self._ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self.pid = os.fork()  # now, while there is one thread
        if self.pid == 0:
            self._ours.close()
            run_program(theirs)
        theirs.close()

    def start(self, program, descriptor, environment):
        """Run a program, which is given one descriptor, in an environment and the current folder."""
        message = json.dumps({"program": program, "descriptor": descriptor, "environment": environment}).encode()
        socket.send_fds(self._ours, [message], [descriptor])

    def terminate(self):
        """Send SIGTERM."""
        os.kill(self.pid, signal.SIGTERM)

    def wait(self):
        """Wait for the end."""
        os.waitpid(self.pid, 0)


def run_program(control):
    """Wait for a program, run it as `python -P -c` would, and exit; without one, end with the other process."""
    message, descriptors, _, _ = socket.recv_fds(control, REQUEST, 1)
    if not message:
        os._exit(0)
    request = json.loads(message)
    (given,) = descriptors
    control.close()
    if given != request["descriptor"]:
        os.dup2(given, request["descriptor"])
        os.close(given)
    os.environ.clear()
    os.environ.update(request["environment"])
    numba.config.reload_config()  # the folder of compiled kernels is that of the run
    sys.argv = ["-c"]
    exec(request["program"], {"__name__": "__main__"})
    sys.exit()


def fork_job_servers(server):
    """From now on `subprocess.Popen` of a job server's program starts it in `server`."""

    class Popen(subprocess.Popen):
        def __new__(cls, command, *arguments, **options):
            if not (isinstance(command, list) and str(command[-1]).startswith(JOB_SERVER)):
                return super().__new__(cls)
            server.start(command[-1], *options["pass_fds"], options["env"])
            return server

    subprocess.Popen = Popen


def run(request):
    """Run Snakemake as `python -m snakemake` would in the request's folder, environment and output file."""
    os.environ.clear()
    os.environ.update(request["environment"])
    os.chdir(request["folder"])
    printed = os.open(request["printed"], os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    for stream in (1, 2):
        os.dup2(printed, stream)
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    library = request["environment"]["PYTHONPATH"].split(os.pathsep)
    sys.path[:1] = library
    if "-n" not in request["arguments"]:
        fork_job_servers(ForkedServer())
    sys.path.insert(0, request["folder"])
    sys.argv = [snakemake.cli.__file__, *request["arguments"]]
    try:
        snakemake.cli.main()
    except SystemExit as ended:
        end(ended.code)


def end(code):
    """Exit; the interpreter's own end would write to, and so copy, nearly all memory shared with the starter."""
    threading._shutdown()
    atexit._run_exitfuncs()
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)


if __name__ == "__main__" and (asked := serve()):
    run(asked)
