"""Trees and their simulation: descriptions, models, states, the simulator, files in and out, the Newton bridge."""
