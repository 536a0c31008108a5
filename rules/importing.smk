"""One flight, its sources read, synchronised and fused on one clock.

Needs  the raw files that the flight's logbook row names
Makes  results/imported/{quadrotor}/{flight}.parquet, {flight}.json and the alignment figure
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
        code=code("importing.py"),
    script:
        "../scripts/importing.py"
