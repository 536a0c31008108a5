"""Simulations of a model in closed loop.

Needs  config/simulations/{simulation}.json, models/{model}/standalone/model.json, tables of wind and reference if named
Makes  results/parts/simulation/{simulation}/*, gathered into results/simulations/{simulation}
"""


rule simulation_flight:
    input:
        simulation_files,
    output:
        table="results/parts/simulation/{simulation}/flight.parquet",
        summary="results/parts/simulation/{simulation}/summary.json",
        text="results/parts/simulation/{simulation}/summary.txt",
    log:
        "logs/simulation/{simulation}/flight.log",
    benchmark:
        "results/benchmarks/simulation/{simulation}.tsv"
    params:
        asked=lambda wildcards: ask(FOLDER.simulation, wildcards.simulation),
        contents=lambda wildcards: contents(simulation_files(wildcards)),
        code=code("simulation_flight.py"),
    script:
        "../scripts/simulation_flight.py"


rule simulation_figures:
    input:
        table="results/parts/simulation/{simulation}/flight.parquet",
        summary="results/parts/simulation/{simulation}/summary.json",
        model=simulation_model,
    output:
        directory("results/parts/simulation/{simulation}/figures"),
    log:
        "logs/simulation/{simulation}/figures.log",
    params:
        contents=lambda wildcards: contents([simulation_model(wildcards)]),
        code=code("simulation_figures.py"),
    script:
        "../scripts/simulation_figures.py"


rule simulation_animation:
    input:
        table="results/parts/simulation/{simulation}/flight.parquet",
        model=simulation_model,
    output:
        directory("results/parts/simulation/{simulation}/animation"),
    log:
        "logs/simulation/{simulation}/animation.log",
    params:
        settings=lambda wildcards: ask(FOLDER.animation, wildcards.simulation),
        contents=lambda wildcards: contents([simulation_model(wildcards)]),
        code=code("simulation_animation.py"),
    script:
        "../scripts/simulation_animation.py"


rule simulation:
    input:
        table="results/parts/simulation/{simulation}/flight.parquet",
        summary="results/parts/simulation/{simulation}/summary.json",
        text="results/parts/simulation/{simulation}/summary.txt",
        pictures=simulation_pictures,
    output:
        folder=directory("results/simulations/{simulation}"),
        table="results/simulations/{simulation}/flight.parquet",
        summary="results/simulations/{simulation}/summary.json",
    log:
        "logs/simulation/{simulation}/simulation.log",
    params:
        code=code("simulation.py"),
    script:
        "../scripts/simulation.py"
