"""The paper's three agents, trained by Stable-Baselines3's PPO."""
