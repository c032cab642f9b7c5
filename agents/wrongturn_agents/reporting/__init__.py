"""Tables and pictures made from the stored results, beside the paper's figures: ``wrongturn results``."""
