"""What an import must ask its user: all of it at once, each with the option that answers it."""

from collections.abc import Sequence
from dataclasses import dataclass

from bayes_iwan.campaign.recording.records import CampaignError


@dataclass(frozen=True)
class Question:
    """What is missing, and what answers it on the command line.

    option : "--force", "--unit" ...; role : of an option that is given for each role, else "". placeholder : stands for
    the answer. text : one sentence.
    """

    option: str
    role: str
    placeholder: str
    text: str

    @property
    def words(self) -> tuple[str, str]:
        """Option and value, the value with a placeholder."""
        return self.option, f"{self.role}={self.placeholder}" if self.role else self.placeholder


class ImportAsks(CampaignError):
    """Recordings that do not say all that is needed; `questions` holds what is missing, `facts` says it in words."""

    def __init__(self, where: str, questions: Sequence[Question]) -> None:
        unique = {(q.option, q.role): q for q in reversed(questions)}
        self.where, self.questions = where, tuple(reversed(unique.values()))
        self.facts = f"{where}: {' '.join(q.text for q in self.questions)}"
        options = " ".join(
            f'{option} "{value}"' if value else option for option, value in (q.words for q in self.questions)
        )
        super().__init__(f"{self.facts} Say it with {options}")
