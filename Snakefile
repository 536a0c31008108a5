"""quasi: from a logbook of quadrotor flights to aerodynamic models. Stages in the order they run."""

from snakemake.utils import min_version

min_version("9.19")


include: "rules/common.smk"
include: "rules/synthesis.smk"
include: "rules/importing.smk"
include: "rules/filtering.smk"
include: "rules/trajectories.smk"
include: "rules/identification.smk"
include: "rules/standalone.smk"
include: "rules/export.smk"
include: "rules/simulation.smk"
include: "rules/gap.smk"
include: "rules/mcap.smk"
include: "rules/pages.smk"


# without a target: every model of the folder
rule all:
    default_target: True
    input:
        every_model,


rule processing:
    input:
        inspected("processing", "flights"),
        every_processed_flight,
