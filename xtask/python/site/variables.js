// The page of variables: shows those that have all words of the field in their names or descriptions.
const field = document.getElementById("filter");
if (field) {
  const words = () => field.value.toLowerCase().split(/\s+/u).filter(Boolean);
  const show = () => {
    let count = 0;
    for (const group of document.querySelectorAll(".variables")) {
      let some = false;
      for (const row of group.children) {
        const text = row.textContent.toLowerCase();
        row.hidden = !words().every((word) => text.includes(word));
        if (!row.hidden) { count += 1; some = true; }
      }
      group.hidden = !some;
      group.previousElementSibling.hidden = !some;
    }
    document.querySelector(".filter output").textContent = field.value ? `${count} found` : "";
  };
  field.addEventListener("input", show);
  show();
}
