"""The paths of all pages, for tests of every page and for the pictures of the documentation."""

from filled_site import Site


def page_paths(site: Site, suite: str) -> dict[str, str]:
    """Return a path of each kind of page, by name. The first two agents have to have finished the suite."""
    (agent, evaluation), (other, _) = ((site.agents[name], site.evaluations[name]) for name in list(site.agents)[:2])
    return {
        "leaderboard": f"/leaderboards/{suite}",
        "agents": "/agents",
        "agent": f"/agents/{agent}?suite={suite}",
        "compare": f"/leaderboards/{suite}/compare?a={agent}&b={other}",
        "episode": f"/episodes/{unsafe_episode(site, evaluation)}",
        "suites": "/suites",
        "suite": f"/suites/{suite}",
        "towns": "/towns",
        "town": "/towns/Town01",
        "submit": "/submit",
        "docs": "/docs",
        "keys": "/keys",
        "about": "/about",
    }


def unsafe_episode(site: Site, evaluation: str) -> str:
    """Return the id of an evaluation's first episode that left the road; of its first one if none did."""
    episodes = site.get(f"/v1/evaluations/{evaluation}/episodes")["episodes"]
    left = [each["id"] for each in episodes if each["outcome"]["verdict"] == "off_road"]
    found: str = [*left, episodes[0]["id"]][0]
    return found
