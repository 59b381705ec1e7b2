"""Measured tests in: the campaign folder, its records, and one phase-averaged loop a test."""

from bayes_iwan.campaign.averaging import Loop, average
from bayes_iwan.campaign.drive import split
from bayes_iwan.campaign.folder import Campaign, read_campaign
from bayes_iwan.campaign.records import CampaignError, Record
from bayes_iwan.campaign.writing import write_campaign

__all__ = ["Campaign", "CampaignError", "Loop", "Record", "average", "read_campaign", "split", "write_campaign"]
