"""Two losses joined with learned weights."""

from torch import Tensor, nn, zeros


class Homoscedastic(nn.Module):
    """The paper's equation 1, after Kendall et al., "Multi-task learning using uncertainty to weigh losses" (2017).

    l = exp(-sigma_rl) l_rl + sigma_rl + exp(-sigma_aux) l_aux + sigma_aux. Both sigmas are learned, from 0 on. A sigma
    falls without end while its loss is negative, which the policy's loss may be: clip the result, or keep the loss
    positive.
    """

    def __init__(self) -> None:
        super().__init__()
        self.sigma_rl = nn.Parameter(zeros(()))
        self.sigma_aux = nn.Parameter(zeros(()))

    def forward(self, rl: Tensor, auxiliary: Tensor) -> Tensor:
        """Join the reinforcement loss () and the auxiliary loss ()."""
        joined: Tensor = (
            (-self.sigma_rl).exp() * rl + self.sigma_rl + (-self.sigma_aux).exp() * auxiliary + self.sigma_aux
        )
        return joined
