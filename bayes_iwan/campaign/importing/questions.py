"""What an import must ask its user: all of it at once, each with the option that answers it."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from bayes_iwan.campaign.recording.records import CampaignError


@dataclass(frozen=True)
class Question:
    """What is missing, and what answers it on the command line.

    option : "--force", "--unit" ...; role : of an option that is given for each role, else "". placeholder : an example
    of the answer, which in < > is none. text : one sentence. check : raises CampaignError for an answer that cannot be.
    """

    option: str
    role: str
    placeholder: str
    text: str
    check: Callable[[str], object] = str

    def words(self, answer: str = "") -> tuple[str, ...]:
        """Option and value as a command line has them; without an answer what it must be put in the place of."""
        answer = answer or f"<{self.placeholder}>"
        return (self.option, f"{self.role}={answer}" if self.role else answer)[: 2 if self.placeholder else 1]


class ImportAsks(CampaignError):
    """Recordings that do not say all that is needed; `questions` holds what is missing, `facts` says it in words."""

    def __init__(self, where: str, questions: Sequence[Question]) -> None:
        unique = {(q.option, q.role): q for q in reversed(questions)}
        self.where, self.questions = where, tuple(reversed(unique.values()))
        self.facts = f"{where}: {' '.join(q.text for q in self.questions)}"
        words = (q.words() for q in self.questions)
        options = " ".join('{} "{}"'.format(*x) if x[1:] else x[0] for x in words)
        super().__init__(f"{self.facts} Say it with {options}")
