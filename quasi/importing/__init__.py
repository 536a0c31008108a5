"""Raw recordings become one synchronised flight: a reader per source format, clocks, frames, the fused table."""
