"""Commands in plain language: read, weighed, obeyed, answered.

`vocabulary` and `grammar` are the language, `parse` reads a sentence into an `intent`, `authorize`
decides whether it is obeyed. `alarm` is what stands everybody at once. `say` is the command,
`command_session` a conversation, `endpoint` its web door.
"""
