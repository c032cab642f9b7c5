"""Training of MaRLn: affordances first, then Rainbow-IQN on the frozen encoder."""
