"""What the stored results come to, beside the paper's figures: ``wrongturn results``."""
