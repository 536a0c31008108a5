"""A process that has imported Snakemake and starts every run as a fork of itself: two seconds less for each.

Imports of others take most of a dry run's time. The library is not among them: every run reads it anew.
Requests are lines of JSON on standard input; the answer to each is its exit code.
"""

import json
import os
import sys

# what every run imports besides the library
import jsonschema  # noqa: F401
import nbformat  # noqa: F401
import pandas  # noqa: F401
import smart_open  # noqa: F401
import snakemake.cli
import snakemake.report.html_reporter

snakemake.cli.get_argument_parser()  # it looks for plugins, and keeps what it finds


def serve():
    """Answer requests until the input ends; returns the request in the forked process that shall run it, else None."""
    for line in sys.stdin:
        process = os.fork()
        if process == 0:
            return json.loads(line)
        status = os.waitpid(process, 0)[1]
        print(os.waitstatus_to_exitcode(status), flush=True)
    return None


def run(request):
    """Run Snakemake as `python -m snakemake` would in the request's folder, environment and output file."""
    os.environ.clear()
    os.environ.update(request["environment"])
    os.chdir(request["folder"])
    printed = os.open(request["printed"], os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    for stream in (1, 2):
        os.dup2(printed, stream)
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    sys.path[:1] = [request["folder"], *request["environment"]["PYTHONPATH"].split(os.pathsep)]
    sys.argv = [snakemake.cli.__file__, *request["arguments"]]
    snakemake.cli.main()


if __name__ == "__main__" and (asked := serve()):
    run(asked)
