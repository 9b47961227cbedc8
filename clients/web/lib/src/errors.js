// A refusal as the service says it: name of the value, what was expected, what came (got) and what cures it.
export class DrapeError extends Error {
  // document: a problem document of the service (docs/reference/wire.md), or the same fields of our own.
  constructor({ name, expected, got, cure, detail, kind, type, status = 0 }) {
    super(detail ?? `${name}: expected ${expected}, got ${got}. ${cure}`);
    this.name = name;
    this.expected = expected;
    this.got = got;
    this.cure = cure;
    this.kind = kind ?? type?.replace("urn:drape:", "") ?? "DrapeError";
    this.status = status;
  }

  toString() {
    return `${this.kind}: ${this.message}`; // its name is that of the value
  }
}
