"""Trees and their motion on a page in the browser, drawn by viser.

Uses: `sim.base`, `sim.effects`, `sim.trees`, `sim.engine`, `sim.formats`, `sim.pictures`.
"""
