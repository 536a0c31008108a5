"""Polynomial models of forces and moments from the training flights of a model.

Needs  results/filtered/{quadrotor}/withGravity|noGravity/{flight}.parquet of the training flights
Makes  results/identified/{model}/shared.json and partition.parquet, made once, and {axis}.json per axis
"""


rule identification_shared:
    input:
        flights=training_flights,
    output:
        shared="results/identified/{model}/shared.json",
        partition="results/identified/{model}/partition.parquet",
    log:
        "logs/identification/{model}/shared.log",
    benchmark:
        "results/benchmarks/identification/{model}/shared.tsv"
    params:
        settings=lambda wildcards: ask(
            FOLDER.model_jobs.identification, wildcards.model
        ),
        code=code("identification_shared.py"),
    script:
        "../scripts/identification_shared.py"


rule identification:
    input:
        flights=training_flights,
        shared="results/identified/{model}/shared.json",
        partition="results/identified/{model}/partition.parquet",
    output:
        "results/identified/{model}/{axis}.json",
    log:
        "logs/identification/{model}/{axis}.log",
    benchmark:
        "results/benchmarks/identification/{model}/{axis}.tsv"
    params:
        settings=lambda wildcards: ask(
            FOLDER.model_jobs.axis, wildcards.model, wildcards.axis
        ),
        code=code("identification.py"),
    script:
        "../scripts/identification.py"
