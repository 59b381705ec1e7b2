"""Measured tests in: the campaign folder, its records, and one phase-averaged loop a test."""

from bayes_iwan.campaign.folders.folder import Campaign, read_campaign
from bayes_iwan.campaign.folders.writing import write_campaign
from bayes_iwan.campaign.loops.averaging import Loop, average
from bayes_iwan.campaign.recording.records import CampaignError, Record

__all__ = ["Campaign", "CampaignError", "Loop", "Record", "average", "read_campaign", "write_campaign"]
