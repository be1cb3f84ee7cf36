/* What users can change: silences and latched alerts. A dialog stays open if the monitor refuses. */
import {request} from "./connection.js";
import {byId, setText} from "./elements.js";
import {countText, patternOf} from "./format.js";

export const AUTHOR = "robot-health-author";

class ActionDialog {
  constructor(id, announce) {
    this.announce = announce;
    this.dialog = byId(id);
    this.error = this.dialog.querySelector(".error-text");
    this.submit = this.dialog.querySelector("[type=submit]");
    this.dialog.querySelector(".cancel").addEventListener("click", () => this.dialog.close());
    this.dialog.querySelector("form").addEventListener("submit", (event) => {
      event.preventDefault();
      this.run();
    });
  }

  /** `action` is called on confirmation, may throw, and returns what screen readers say. */
  ask(action) {
    this.action = action;
    setText(this.error, "");
    this.submit.disabled = false;
    this.dialog.showModal();
  }

  async run() {
    const {action} = this;
    this.submit.disabled = true;
    setText(this.error, "");
    try {
      const said = await action();
      if (action === this.action) this.dialog.close();
      this.announce(said);  // not before: what is outside of an open dialog is not read out
    } catch (error) {
      setText(this.error, `Failed: ${error.message}`);
    }
    this.submit.disabled = false;
  }
}

export class Actions {
  constructor(announce) {
    this.silenceDialog = new ActionDialog("silence-dialog", announce);
    this.confirmDialog = new ActionDialog("confirm-dialog", announce);
  }

  /** Asks for how long and why, then silences; `open`: a signal with an open alert, whose end can be waited for. */
  silence(robot, signal, open, time = "3600") {
    const field = (name) => byId(`silence-${name}`);
    field("robot").value = patternOf(robot);
    field("signal").value = signal === "*" ? signal : patternOf(signal);
    field("reason").value = "";
    field("author").value = remembered(AUTHOR);
    const untilResolved = field("time").querySelector("[value=resolved]");
    untilResolved.disabled = !open;
    setText(field("effects"), open && open.affects ? `Also covers ${countText(open.affects, "signal")} that it affects.` : "");
    field("time").value = time;
    this.silenceDialog.ask(async () => {
      const time = field("time").value, author = field("author").value.trim();
      remember(AUTHOR, author);
      await request("api/silence", {
        robot: field("robot").value.trim(),
        signal: field("signal").value.trim(),
        ...(time === "resolved" ? {until_resolved: true} : {for_s: Number(time)}),
        reason: field("reason").value.trim(),
        author,
      });
      return "silenced";
    });
    field(time === "resolved" ? "reason" : "time").focus();
  }

  expire(silence) {
    this.confirm("End this silence?", `Notifications for ${silence.matchers} are sent again.`, "End silence", async () => {
      await request("api/silence/expire", {id: silence.id, author: remembered(AUTHOR)});
      return "silence ended";
    });
  }

  reset(robot) {
    const text = `Clears the latched alerts of ${robot}. An alert whose condition is still true stays.`;
    this.confirm("Reset latched alerts?", text, "Reset", async () => {
      return (await request("api/reset", {robot})).message;
    });
  }

  confirm(title, text, button, action) {
    setText(byId("confirm-title"), title);
    setText(byId("confirm-text"), text);
    setText(this.confirmDialog.submit, button);
    this.confirmDialog.ask(action);
  }
}

/** Returns a text that this browser keeps; empty: none, or storage is forbidden. */
export function remembered(key) {
  try {
    return localStorage.getItem(key) || "";
  } catch (error) {
    return "";
  }
}

export function remember(key, text) {
  try {
    localStorage.setItem(key, text);
  } catch (error) {
    // forbidden
  }
}
