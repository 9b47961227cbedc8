// The clothes that an avatar came in: the service's answer says which of them lie below and over what was named.

// Names them among the garments of wearing, a Wearing; reopen(others) opens its stream with other options. What it promises
// takes options by layer of what was named to all that is worn: own clothes have no size, and no fabric of a list.
export async function nameOwn(wearing, reopen) {
  const named = wearing.garments;
  await reopen({ fabric: undefined, geometry: undefined, folds_by: undefined });
  const { garments, garment } = wearing.stream.opened;
  wearing.garments = garments?.map(({ id }) => id) ?? [garment];
  const each = (list) => wearing.garments.map((id) => list[named.indexOf(id)] ?? null);
  const spread = ({ alive, ...options }) => {
    const { fabric, size } = options;
    if (Array.isArray(fabric)) options.fabric = each(fabric);
    if (size) options.size = each(Array.isArray(size) ? size : named.map(() => size));
    return options;
  };
  wearing.options = spread(wearing.options);
  return spread;
}
