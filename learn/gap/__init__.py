"""The gap between simulation and measurement: where it is, what is missing, and what is left once that is added."""
