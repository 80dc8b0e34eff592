"""A service between a robot arm and its controllers: limits, leases, a log of every tick, a twin, rosbridge.

Uses: `sim.base`, `sim.arms`, `sim.cameras`, `sim.scenes`, `learn.touch`, `learn.hidden`.
"""
