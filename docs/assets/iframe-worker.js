// Browsers refuse workers to pages that were opened from disk; there a hidden frame does the
// work of one, so that the search needs no server. Elsewhere this does nothing.
if (location.protocol === "file:") {
  window.Worker = class extends EventTarget {
    constructor(address) {
      super();
      this.waiting = [];
      this.frame = document.createElement("iframe");
      this.frame.hidden = true;
      this.frame.srcdoc = "<!doctype html><title>search</title>";
      this.frame.onload = () => this.begin(new URL(address, document.baseURI).href);
      document.documentElement.append(this.frame);
    }

    begin(address) {
      this.frame.onload = null;
      const room = this.frame.contentWindow;
      room.postMessage = (data) => this.tell(data);
      const script = room.document.createElement("script");
      script.src = address;
      script.onload = () => {
        this.room = room;
        this.waiting.splice(0).forEach((data) => this.postMessage(data));
      };
      script.onerror = () => this.dispatchEvent(new Event("error")) && this.onerror?.(new Event("error"));
      room.document.head.append(script);
    }

    tell(data) {
      const event = new MessageEvent("message", { data });
      setTimeout(() => {
        this.dispatchEvent(event);
        this.onmessage?.(event);
      });
    }

    postMessage(data) {
      if (this.room) {
        this.room.dispatchEvent(new this.room.MessageEvent("message", { data }));
      } else {
        this.waiting.push(data);
      }
    }

    terminate() {
      this.frame.remove();
    }
  };
}
