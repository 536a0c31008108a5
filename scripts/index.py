"""The index page of the folder: what stands in it, with verdicts and links."""

from quasi.pages.index import write_index
from quasi.running.job_log import job

if __name__ == "__main__":
    with job(snakemake.log[0], "index of the folder", snakemake.output[0]):
        write_index(".", snakemake.output[0])
