"""One flight, its sources read, synchronised and fused on one clock.

Needs  the raw files that the flight's logbook row names
Makes  results/imported/{quadrotor}/{flight}.parquet and {flight}.json; then, from these and the filtered flight, the page
       results/reports/{quadrotor}/{flight}.html and its figures, results/parts/filtering/{quadrotor}/{flight}/*.png
"""


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
    params:
        settings=lambda wildcards: ask(
            FOLDER.importing, wildcards.quadrotor, wildcards.flight
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
