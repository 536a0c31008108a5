"""Jobs forked from a server behave as jobs that start Python: arguments, folder, environment, exit codes, signals."""

import json
import os
import signal
import subprocess
import sys
import time
from contextlib import suppress
from types import SimpleNamespace

import psutil
import pytest
from snakemake.benchmark import BenchmarkRecord
from snakemake.script import PythonScript

from quasi.running.job_server import JobServer, use_server

ENVIRONMENT = {"PATH": os.environ["PATH"], "OF_THE_JOB": "1"}

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="the server needs Linux")


@pytest.fixture
def server():
    found = JobServer(modules=("colorsys",))
    yield found
    found.close()


def start(server, folder, text, name="script.py"):
    (folder / name).write_text(text)
    return server.start(name, ENVIRONMENT)


def test_a_job_sees_what_it_sees_in_its_own_python(server, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    text = (
        "import json, os, sys; about = [__name__, __file__, sys.argv, sys.path[0], os.getcwd(), dict(os.environ),"
        "'colorsys' in sys.modules, os.getpid()]\nwith open('seen.json', 'w') as f: json.dump(about, f)"
    )
    job = start(server, tmp_path, text)
    assert job.wait() == 0
    name, file, arguments, path, folder, environment, imported, pid = json.loads((tmp_path / "seen.json").read_text())
    script = str(tmp_path / "script.py")
    assert (name, file, arguments, path, folder) == ("__main__", script, [script], str(tmp_path), str(tmp_path))
    assert environment == ENVIRONMENT and imported and pid == job.pid


@pytest.mark.parametrize(
    ("text", "code"),
    [
        ("raise SystemExit(3)", 3),
        ("1 / 0", 1),
        ("import os, signal; os.kill(os.getpid(), signal.SIGTERM)", -signal.SIGTERM),
        ("import os, signal; os.kill(os.getpid(), signal.SIGINT)", -signal.SIGINT),
        ("import atexit, os; atexit.register(os._exit, 7)", 7),
    ],
)
def test_a_job_ends_with_its_own_code(server, tmp_path, monkeypatch, text, code):
    monkeypatch.chdir(tmp_path)
    assert start(server, tmp_path, text).wait() == code


def test_two_jobs_run_at_once(server, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    os.mkfifo("pipe")
    reader = start(server, tmp_path, "raise SystemExit(len(open('pipe').read()))")
    writer = start(server, tmp_path, "open('pipe', 'w').write('four')", "writer.py")
    assert (writer.wait(), reader.wait()) == (0, 4)


def test_an_ended_server_fails_its_job_and_starts_no_other(server, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    job = start(server, tmp_path, "import time; time.sleep(600)")
    process = psutil.Process(job.pid)
    server._process.kill()
    process.kill()
    assert job.wait() < 0
    assert server.start("script.py", ENVIRONMENT) is None


@pytest.mark.parametrize("room", [None, "quasi.importing"])
def test_jobs_end_with_the_main_process(tmp_path, monkeypatch, room):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "script.py").write_text("import time; time.sleep(600)")
    program = (
        "import os; from quasi.running.job_server import JobServer; server = JobServer(modules=());"
        f"job = server.start('script.py', os.environ, {room!r}); print(job.pid, flush=True); os.kill(os.getpid(), 9)"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=120)
    with suppress(psutil.NoSuchProcess):  # it may have ended already
        psutil.Process(int(done.stdout)).wait(30)


def test_scripts_of_snakemake_run_in_the_server_unless_they_ask_for_more(server, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    started = []
    monkeypatch.setattr(PythonScript, "execute_script", lambda self, fname, edit=False: started.append(fname))
    use_server(PythonScript, server)
    (tmp_path / "script.py").write_text("import os, sys; sys.exit(int(os.environ['OMP_NUM_THREADS']) + 40)")
    job = SimpleNamespace(
        threads=2, conda_env=None, container_img=None, env_modules=None, resources={}, bench_record=None
    )
    with pytest.raises(subprocess.CalledProcessError) as raised:
        PythonScript.execute_script(job, "script.py")
    assert raised.value.returncode == 41
    (tmp_path / "script.py").write_text(
        "import time\nheld = bytearray(300 << 20)\nwhile time.process_time() < 0.4: pass\n"
        "open('file', 'wb').write(bytes(4 << 20))"
    )
    job.bench_record = BenchmarkRecord()
    PythonScript.execute_script(job, "script.py")
    used = dict(zip(BenchmarkRecord.get_header(False), job.bench_record.to_tsv(False).split("\t")))
    assert 0.4 <= float(used["cpu_time"]) <= float(used["s"]) + 0.1
    assert 300.0 < float(used["max_rss"]) < 1000.0
    assert float(used["mean_load"]) == pytest.approx(100.0 * float(used["cpu_time"]) / float(used["s"]), rel=0.05)
    job.conda_env = "own.yaml"
    PythonScript.execute_script(job, "own.py")
    assert started == ["own.py"]


def _lives(process):
    try:
        return process.is_running() and process.status() != psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return False


def all_end(processes, seconds=20.0):
    """Whether processes end in time; one that ended and that nobody has waited for yet counts as well."""
    deadline = time.monotonic() + seconds
    left = list(processes)
    while left and time.monotonic() < deadline:
        left = [p for p in left if _lives(p)]
        time.sleep(0.05)
    return not left


def children_of(server):
    return psutil.Process(server._process.pid).children(recursive=True)


def test_a_job_of_a_room_finds_its_kernels_compiled(server, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    text = (
        "import sys; from quasi.filtering.ekf import _forward; from quasi.importing import kernels\n"
        "sys.exit(10 * len(_forward.signatures))"
    )
    (tmp_path / "script.py").write_text(text)
    jobs = [server.start("script.py", ENVIRONMENT, "quasi.filtering") for _ in range(2)]
    assert [job.wait() for job in jobs] == [10, 10]
    processes = children_of(server)
    assert len(processes) == 1  # with one core no other room prepares itself
    server.close()
    assert all_end(processes)


def test_later_rooms_prepare_themselves_and_end_with_the_server(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    server = JobServer(modules=(), cores=2)
    assert start(server, tmp_path, "raise SystemExit(5)").wait() == 5
    (tmp_path / "script.py").write_text("import sys; sys.exit('quasi.importing.kernels' in sys.modules)")
    assert server.start("script.py", ENVIRONMENT, "quasi.importing").wait() == 1
    deadline = time.monotonic() + 120.0
    while len(processes := children_of(server)) < 3:  # importing; filtering, and behind it identification
        assert time.monotonic() < deadline
        time.sleep(0.1)
    server.close()
    assert all_end(processes)


def test_without_its_room_a_job_starts_python_itself(server, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "script.py").write_text("raise SystemExit(6)")
    assert server.start("script.py", ENVIRONMENT, "quasi.importing").wait() == 6
    (room,) = children_of(server)
    room.kill()
    psutil.wait_procs([room], 30)
    assert server.start("script.py", ENVIRONMENT, "quasi.importing") is None
