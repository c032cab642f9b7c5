"""Training of ``doubting``: what a picture says about the junction ahead, learned from the towns' geometry."""
