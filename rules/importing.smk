"""One flight, its sources read, synchronised and fused on one clock.

Needs  the raw files that the flight's logbook row names
Makes  results/inspected/models|gaps|processing/{asked}.json, what the raw files of a model, a gap or all processed flights
       hold; a fault that they show stops it before a flight is imported (`quasi check` shows the same);
       results/imported/{quadrotor}/{flight}.parquet and {flight}.json; then, from these and the filtered flight, the page
       results/reports/{quadrotor}/{flight}.html and its figures, results/parts/filtering/{quadrotor}/{flight}/*.png
"""


rule inspection:
    input:
        inspected_files,
    output:
        "results/inspected/{kind}/{asked}.json",
    log:
        "logs/inspection/{kind}/{asked}.log",
    # before any flight is imported, and alone: what cannot be made stops here, unless other flights are to go on
    priority: 100
    resources:
        flights=inspection_share,
    params:
        asked=lambda w: ask(FOLDER.inspection, w.kind, w.asked),
        names=row_names,
        contents=lambda w: contents(inspected_files(w)),
        code=code("inspection.py"),
    script:
        "../scripts/inspection.py"


rule importing:
    input:
        raw_files,
    output:
        flight="results/imported/{quadrotor}/{flight}.parquet",
        metadata="results/imported/{quadrotor}/{flight}.json",
    log:
        "logs/importing/{quadrotor}/{flight}.log",
    benchmark:
        "results/benchmarks/importing/{quadrotor}/{flight}.tsv"
    resources:
        flights=1,
    params:
        settings=lambda wildcards: ask(
            FOLDER.recordings.importing, wildcards.quadrotor, wildcards.flight
        ),
        # the path alone: the job reads the row, so that a changed comment or a moved row makes nothing stale; nor does
        # a renamed logbook, for Snakemake compares no parameter that is asked with the input
        logbook=lambda wildcards, input: (
            ask(FOLDER.logbooks.row, wildcards.quadrotor, wildcards.flight).logbook
        ),
        contents=lambda wildcards: contents(raw_files(wildcards)),
        code=code("importing.py"),
    script:
        "../scripts/importing.py"


rule importing_report:
    input:
        flight="results/imported/{quadrotor}/{flight}.parquet",
        metadata="results/imported/{quadrotor}/{flight}.json",
        filtered="results/filtered/{quadrotor}/withGravity/{flight}.parquet",
        filtered_metadata="results/filtered/{quadrotor}/withGravity/{flight}.json",
        convergence="results/filtered/{quadrotor}/convergence/{flight}.parquet",
    output:
        page="results/reports/{quadrotor}/{flight}.html",
        figures=directory("results/parts/filtering/{quadrotor}/{flight}"),
    log:
        "logs/importing_report/{quadrotor}/{flight}.log",
    params:
        code=code("importing_report.py"),
    script:
        "../scripts/importing_report.py"
