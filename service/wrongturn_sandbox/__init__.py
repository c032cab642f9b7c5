"""Runs models of strangers where they can do no harm: the guest inside, the host outside. It knows no other part."""
