"""Models in other languages and for simulators, each compared with the model itself before it is handed over.

Needs  models/{model}/standalone/model.json
Makes  models/{model}/c, fmu, python, matlab: sources and agreement.json, agreement.txt
       models/{model}/<simulator>: its files, constants.json, constants.txt, agreement.json, agreement.txt
"""


rule export_c:
    input:
        model=model_to_export,
    output:
        folder=directory("models/{model}/c"),
        report="models/{model}/c/agreement.json",
    log:
        "logs/export/{model}/c.log",
    benchmark:
        "results/benchmarks/export/{model}/c.tsv"
    params:
        contents=lambda wildcards: contents([model_to_export(wildcards)]),
        code=code("export_c.py"),
    script:
        "../scripts/export_c.py"


rule export_fmu:
    input:
        model=model_to_export,
        sources=expand(
            f"{LIBRARY}/quasi/export/fmu_files/{{file}}",
            file=[
                "interface.h",
                "instance.h",
                "fmu.c",
                "forces_and_moments.c",
                "vehicle.c",
            ],
        ),
    output:
        folder=directory("models/{model}/fmu"),
        report="models/{model}/fmu/agreement.json",
    log:
        "logs/export/{model}/fmu.log",
    benchmark:
        "results/benchmarks/export/{model}/fmu.tsv"
    params:
        contents=lambda wildcards: contents([model_to_export(wildcards)]),
        code=code("export_fmu.py"),
    script:
        "../scripts/export_fmu.py"


rule export_python:
    input:
        model=model_to_export,
    output:
        folder=directory("models/{model}/python"),
        report="models/{model}/python/agreement.json",
    log:
        "logs/export/{model}/python.log",
    benchmark:
        "results/benchmarks/export/{model}/python.tsv"
    params:
        contents=lambda wildcards: contents([model_to_export(wildcards)]),
        code=code("export_python.py"),
    script:
        "../scripts/export_python.py"


rule export_matlab:
    input:
        model=model_to_export,
        files=matlab_files,
    output:
        folder=directory("models/{model}/matlab"),
        report="models/{model}/matlab/agreement.json",
    log:
        "logs/export/{model}/matlab.log",
    benchmark:
        "results/benchmarks/export/{model}/matlab.tsv"
    params:
        settings=lambda wildcards: ask(FOLDER.model_jobs.matlab, wildcards.model),
        contents=lambda wildcards: contents([model_to_export(wildcards)]),
        code=code("export_matlab.py"),
    script:
        "../scripts/export_matlab.py"


# one rule for all simulators: quasi.export.registry lists them
rule export_simulator:
    input:
        model=model_to_export,
    output:
        folder=directory("models/{model}/{simulator}"),
        report="models/{model}/{simulator}/agreement.json",
    log:
        "logs/export/{model}/{simulator}.log",
    benchmark:
        "results/benchmarks/export/{model}/{simulator}.tsv"
    params:
        contents=lambda wildcards: contents([model_to_export(wildcards)]),
        code=code("export_simulator.py"),
    script:
        "../scripts/export_simulator.py"
