"""Agents, and the worker that drives them against a service."""

from wrongturn_agents.agent import Agent
from wrongturn_agents.errors import AgentsError
from wrongturn_agents.registry import AGENTS, AgentListing, AgentSource, list_agents, resolve

__all__ = ["AGENTS", "Agent", "AgentListing", "AgentSource", "AgentsError", "list_agents", "resolve"]
