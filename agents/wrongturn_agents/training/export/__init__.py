"""Trained agents as ONNX files: export, smaller weights, cards and films."""
