"""The index page of a project folder.

Needs  nothing: it lists the flights, models, simulations and gaps that stand in the folder, and never makes them
Makes  results/index.html; every run that ends well refreshes it (see common.smk)
"""


rule index:
    input:
        # absolute: newer files make the page stale, and no job waits for another
        lambda wildcards: list_sources("."),
    output:
        "results/index.html",
    log:
        "logs/index.log",
    params:
        code=code("index.py"),
    script:
        "../scripts/index.py"
