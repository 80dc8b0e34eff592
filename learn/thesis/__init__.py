"""The thesis again, in simulation."""
