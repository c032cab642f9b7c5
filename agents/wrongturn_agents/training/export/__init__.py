"""Trained agents as ONNX files: export, smaller weights and cards."""
