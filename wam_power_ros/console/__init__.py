# SPDX-License-Identifier: Apache-2.0
"""What a person does at a terminal: teach, replay, run a policy, give feedback."""
