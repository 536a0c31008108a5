"""Gather the finished model, its scores and figures into the folder that is handed over."""

from quasi.running.job_log import hand_over_with_summary, job

if __name__ == "__main__":
    with job(snakemake.log[0], f"model {snakemake.wildcards.model}"):
        files = [str(path) for name, path in snakemake.input.items() if name != "inspected"]
        hand_over_with_summary(files, snakemake.output.folder)
