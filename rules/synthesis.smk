"""Made flights as raw logs in the real formats.

Needs  config/synthesis/{campaign}.json
Makes  results/synthesis/{campaign}/onboard/{flight}.bbl, optitrack/{flight}.csv, truth/{flight}.parquet
"""


rule synthesis:
    output:
        onboard="results/synthesis/{campaign}/onboard/{flight}.bbl",
        capture="results/synthesis/{campaign}/optitrack/{flight}.csv",
        truth="results/synthesis/{campaign}/truth/{flight}.parquet",
    log:
        "logs/synthesis/{campaign}/{flight}.log",
    benchmark:
        "results/benchmarks/synthesis/{campaign}/{flight}.tsv"
    params:
        campaign=lambda wildcards: ask(
            FOLDER.configuration.made_flight, wildcards.campaign, wildcards.flight
        ),
        code=code("synthesis.py"),
    script:
        "../scripts/synthesis.py"
