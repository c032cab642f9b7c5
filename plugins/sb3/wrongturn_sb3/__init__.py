"""Policies of Stable-Baselines3 as agents, and as ONNX files."""
