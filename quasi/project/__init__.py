"""The project folder: logbook, configuration, and what flights, models, gaps and simulations ask for."""
