"""Training of "Learning by Cheating": a privileged agent learns from rules, and an agent with a camera from it."""
