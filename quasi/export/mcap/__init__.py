"""MCAP files of flights, simulations and gaps with Foxglove's schemas, and layouts for PlotJuggler."""
