"""The portable model: one JSON file that needs nothing else, its scores, its page and figures.

Needs  results/identified/{model}/*.json, or of an extended model results/parts/gap/{gap}/model.json; the filtered flights, held-out ones included, for judging only
Makes  results/parts/standalone/{model}/*, gathered into models/{model}/standalone
"""


rule standalone_model:
    input:
        unpack(model_sources),
    output:
        "results/parts/standalone/{model}/model.json",
    log:
        "logs/standalone/{model}/model.log",
    params:
        flights=lambda wildcards: ask(FOLDER.model_jobs.roles, wildcards.model),
        settings=lambda wildcards: ask(FOLDER.model_jobs.standalone, wildcards.model),
        code=code("standalone_model.py"),
    script:
        "../scripts/standalone_model.py"


rule standalone_scores:
    input:
        unpack(base_of),
        model="results/parts/standalone/{model}/model.json",
        partition=partition_of,
        flights=all_flights,
    output:
        scores="results/parts/standalone/{model}/scores.parquet",
        diagnosis="results/parts/standalone/{model}/diagnostics.json",
        coverage="results/parts/standalone/{model}/coverage.parquet",
        rows="results/parts/standalone/{model}/comparison.parquet",
        summary="results/parts/standalone/{model}/summary.txt",
        summary_json="results/parts/standalone/{model}/summary.json",
        summary_latex="results/parts/standalone/{model}/summary.tex",
    log:
        "logs/standalone/{model}/scores.log",
    benchmark:
        "results/benchmarks/standalone/{model}/scores.tsv"
    params:
        flights=lambda wildcards: ask(FOLDER.model_jobs.roles, wildcards.model),
        options=lambda wildcards: ask(FOLDER.model_jobs.partitioning, wildcards.model),
        code=code("standalone_scores.py"),
    script:
        "../scripts/standalone_scores.py"


rule standalone_figures:
    input:
        model="results/parts/standalone/{model}/model.json",
        partition=partition_of,
        flights=all_flights,
    output:
        directory("results/parts/standalone/{model}/figures"),
    log:
        "logs/standalone/{model}/figures.log",
    benchmark:
        "results/benchmarks/standalone/{model}/figures.tsv"
    threads: 2
    params:
        flights=lambda wildcards: ask(FOLDER.model_jobs.roles, wildcards.model),
        options=lambda wildcards: ask(FOLDER.model_jobs.partitioning, wildcards.model),
        code=code("standalone_figures.py"),
    script:
        "../scripts/standalone_figures.py"


rule standalone_trajectories:
    input:
        flights=all_flights,
    output:
        directory("results/parts/standalone/{model}/trajectories"),
    log:
        "logs/standalone/{model}/trajectories.log",
    benchmark:
        "results/benchmarks/standalone/{model}/trajectories.tsv"
    params:
        settings=lambda wildcards: ask(FOLDER.model_jobs.trajectories, wildcards.model),
        code=code("standalone_trajectories.py"),
    script:
        "../scripts/standalone_trajectories.py"


rule standalone_report:
    input:
        model="results/parts/standalone/{model}/model.json",
        summary_json="results/parts/standalone/{model}/summary.json",
        diagnosis="results/parts/standalone/{model}/diagnostics.json",
        coverage="results/parts/standalone/{model}/coverage.parquet",
        rows="results/parts/standalone/{model}/comparison.parquet",
    output:
        "results/parts/standalone/{model}/report.html",
    log:
        "logs/standalone/{model}/report.log",
    params:
        code=code("standalone_report.py"),
    script:
        "../scripts/standalone_report.py"


rule standalone:
    input:
        inspected=inspected_for_model,
        model="results/parts/standalone/{model}/model.json",
        report="results/parts/standalone/{model}/report.html",
        scores="results/parts/standalone/{model}/scores.parquet",
        diagnosis="results/parts/standalone/{model}/diagnostics.json",
        coverage="results/parts/standalone/{model}/coverage.parquet",
        rows="results/parts/standalone/{model}/comparison.parquet",
        summary="results/parts/standalone/{model}/summary.txt",
        summary_json="results/parts/standalone/{model}/summary.json",
        summary_latex="results/parts/standalone/{model}/summary.tex",
        figures="results/parts/standalone/{model}/figures",
        trajectories="results/parts/standalone/{model}/trajectories",
    output:
        folder=directory("models/{model}/standalone"),
        model="models/{model}/standalone/model.json",
        report="models/{model}/standalone/report.html",
        scores="models/{model}/standalone/scores.parquet",
        diagnosis="models/{model}/standalone/diagnostics.json",
        summary="models/{model}/standalone/summary.txt",
    log:
        "logs/standalone/{model}/standalone.log",
    params:
        code=code("standalone.py"),
    script:
        "../scripts/standalone.py"
