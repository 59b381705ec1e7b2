"""Measured tests in: the campaign folder, its records, and one phase-averaged loop a test."""

from .averaging import Loop, average
from .folder import Campaign, read_campaign, write_campaign
from .records import CampaignError, Record

__all__ = ["Campaign", "CampaignError", "Loop", "Record", "average", "read_campaign", "write_campaign"]
