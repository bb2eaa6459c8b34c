# SPDX-License-Identifier: Apache-2.0
"""Client of the nodes of one arm: requests and answers, rollouts, a person's feedback."""
