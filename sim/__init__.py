"""Trees and their simulation: descriptions, models, states, the simulator, arms, scenes, files in and out."""
