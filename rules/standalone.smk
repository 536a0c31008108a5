"""The portable model: one JSON file that needs nothing else, its scores and figures.

Needs  results/identified/{model}/*.json; the filtered flights, held-out ones included, for the scores only
Makes  results/parts/standalone/{model}/*, gathered into models/{model}/standalone
"""


rule standalone_model:
    input:
        axes=axis_parts,
        shared="results/identified/{model}/shared.json",
        partition="results/identified/{model}/partition.parquet",
        flights=training_flights,
    output:
        "results/parts/standalone/{model}/model.json",
    log:
        "logs/standalone/{model}/model.log",
    params:
        flights=lambda wildcards: {
            role: [r.key for r in ask(FOLDER.model_flights, wildcards.model, role)]
            for role in ("training", "validation")
        },
        settings=lambda wildcards: ask(FOLDER.standalone, wildcards.model),
        code=code("standalone_model.py"),
    script:
        "../scripts/standalone_model.py"


rule standalone_scores:
    input:
        model="results/parts/standalone/{model}/model.json",
        partition="results/identified/{model}/partition.parquet",
        flights=all_flights,
    output:
        scores="results/parts/standalone/{model}/scores.parquet",
        summary="results/parts/standalone/{model}/summary.txt",
        figures=directory("results/parts/standalone/{model}/comparison"),
    log:
        "logs/standalone/{model}/scores.log",
    benchmark:
        "results/benchmarks/standalone/{model}/scores.tsv"
    params:
        flights=lambda wildcards: {
            role: [r.key for r in ask(FOLDER.model_flights, wildcards.model, role)]
            for role in ("training", "validation")
        },
        options=lambda wildcards: ask(FOLDER.identification, wildcards.model)[
            "data partitioning"
        ],
        code=code("standalone_scores.py"),
    script:
        "../scripts/standalone_scores.py"


rule standalone:
    input:
        model="results/parts/standalone/{model}/model.json",
        scores="results/parts/standalone/{model}/scores.parquet",
        summary="results/parts/standalone/{model}/summary.txt",
        figures="results/parts/standalone/{model}/comparison",
    output:
        folder=directory("models/{model}/standalone"),
        model="models/{model}/standalone/model.json",
        scores="models/{model}/standalone/scores.parquet",
        summary="models/{model}/standalone/summary.txt",
    log:
        "logs/standalone/{model}/standalone.log",
    params:
        code=code("standalone.py"),
    script:
        "../scripts/standalone.py"
