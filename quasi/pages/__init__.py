"""HTML pages, charts, drawings and animations; plain data and tables in, text and figures out."""
