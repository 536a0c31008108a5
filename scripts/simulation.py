"""Gather a finished simulation, its summary and pictures into the folder that is handed over."""

from quasi.running.job_log import hand_over_with_summary, job

if __name__ == "__main__":
    with job(snakemake.log[0], f"simulation {snakemake.wildcards.simulation}"):
        hand_over_with_summary(snakemake.input, snakemake.output.folder)
