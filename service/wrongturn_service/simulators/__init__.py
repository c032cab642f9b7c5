"""Simulators: processes that each run one libsumo simulation."""
