"""What results show: dose and response, effects of factors, and power. Three commands of ``wrongturn``."""
